// The three stages of Chang et al. 2008, each gone through only when what it depends on has changed.

import { decompose, rings } from "./decomposition.js";
import { Medium } from "./medium.js";
import { Memory } from "./memory.js";
import { AUTOMATIC, CompositePass } from "./passes/composite.js";
import { DotsPass } from "./passes/dots.js";
import { kindOf } from "./passes/gather.js";
import { IntegratePass } from "./passes/integrate.js";
import { IrradiancePass } from "./passes/irradiance.js";
import { NearMapPass } from "./passes/near_map.js";
import { ProfilePass, far, near } from "./passes/profile.js";
import { PyramidPass } from "./passes/pyramid.js";
import { SamplePass } from "./passes/samples.js";
import { ShadowPass, lampView } from "./passes/shadow.js";
import { SurfacePass } from "./passes/surface.js";
import { floorBelow, viewOf } from "./framing.js";
import { perspective, times } from "./vectors.js";

/** @import { Body } from "./body.js" */
/** @import { Camera } from "./framing.js" */
/** @import { Device, Texture, Values } from "./device.js" */
/** @import { Coefficients, MediumTable } from "./medium.js" */
/** @import { ProfileRows } from "./passes/profile.js" */
/** @import { Lamp, LampView } from "./passes/shadow.js" */
/** @import { Vector } from "./vectors.js" */

/** Pictures, each through another place in the pixels and with other samples, that a settled one is the mean of. */
export const PASSES = 16;
export const MOST_LAMPS = 4;

const SHADOW_SIZE = 2048;
const NEAR_SIZE = 1024;
const BIAS = 0.001; // of shadow rays, over the radius of the body
const TURN = Math.PI * (3 - Math.sqrt(5)); // fills the circle evenly
const NO_SKY = Array.from({ length: 27 }, () => 0);
const R2 = [0.7548776662466927, 0.5698402909980532]; // fills the unit square evenly (Roberts 2018)

/** Where sums are made. */
export const MODES = /** @type {const} */ (["pixels", "quarter", "sixteenth", "vertices"]);
const STRIDES = { pixels: 1, quarter: 2, sixteenth: 4, vertices: 1 };

/** @typedef {typeof MODES[number]} Mode */

/**
 * What a picture is made of; whoever changes it calls `frame` again.
 * @typedef {object} State
 * @property {Coefficients} medium [1/mm] @property {number} millimetres the longest side of the body
 * @property {Lamp[]} lamps @property {Vector[] | null} sky radiance in nine spherical harmonics
 * @property {number} samples N @property {boolean} hybrid
 * @property {boolean} autoExposure @property {number} stops
 * @property {number} highlight @property {number} roughness
 * @property {boolean} floor @property {Vector} background @property {boolean} [dots] show the samples
 */

/**
 * Constants of the methods, from Python.
 * @typedef {object} Constants
 * @property {number} evenWithin @property {number} smallestDisc @property {number} largestDisc @property {number} farDisc @property {number} overlap
 * @property {number} discSizes @property {number} opennessScale
 * @property {number} steepestCurve the largest beta @property {number} tightest radius of the smallest sphere on which mu is believed
 *   [mean free paths]
 * @property {Vector} floorColour reflectance @property {number} floorReach in radii of the body
 */

export class Engine {
  /**
   * @param {Device} device @param {Body} body @param {MediumTable} table @param {Constants} constants
   * @param {[number, number][]} shifts of the samples, pass by pass @param {Vector} up
   */
  constructor(device, body, table, constants, shifts, up) {
    this.device = device;
    this.body = body;
    this.table = table;
    this.constants = constants;
    this.shifts = shifts;
    this.memory = new Memory();
    this.profiles = new ProfilePass(device);
    this.shadow = new ShadowPass(device, body, SHADOW_SIZE);
    this.nearMap = new NearMapPass(device, body, NEAR_SIZE);
    this.irradiance = new IrradiancePass(device, body);
    this.pyramid = new PyramidPass(device, this.irradiance.sums, this.irradiance.levels);
    this.samples = new SamplePass(device, body);
    this.surface = new SurfacePass(device, body);
    const kind = kindOf(table);
    this.vertices = new IntegratePass(device, kind);
    this.vertices.allocate(body.vertexPlaces.width, body.vertexPlaces.height, 1, "RGBA32F");
    this.pixels = new IntegratePass(device, kind);
    this.composite = new CompositePass(device, kind);
    this.dots = new DotsPass(device);
    this.floor = floorBelow(body, up, constants.floorReach);
    /** @type {LampView[]} */
    this.views = [];
    /** @type {Record<string, ProfileRows>} */
    this.rows = {};
    this.ringPlaces = device.upload(1, 1, new Float32Array(4));
    this.ringCount = 0;
    this.pairs = 0;
    this.matrix = perspective(1, 1, 1, 2);
  }

  /** How often each stage was gone through. */
  get counts() {
    const { profiles, shadow, nearMap, irradiance, samples, surface, vertices, pixels } = this;
    const passes = { profiles, shadow, nearMap, irradiance, samples, surface, vertices, pixels };
    return Object.fromEntries(Object.entries(passes).map(([name, pass]) => [name, pass.count]));
  }

  // ---------------------------------------------------------------- stages 0 to 2: medium, light, samples

  /** @param {State} state */
  updateProfile(state) {
    const { body, constants } = this;
    const isHybrid = state.hybrid && state.lamps.length > 0 && this.views.every((view) => view.whole);
    const skyApart = isHybrid && state.sky !== null;
    const changed = this.memory.changed("profile", [state.medium, state.millimetres, isHybrid, skyApart]);
    if (!changed) return;
    this.device.free(...new Set(Object.values(this.rows).map((rows) => rows.texture)));
    const millimetres = state.millimetres / body.extent;
    this.medium = new Medium(this.table, state.medium, millimetres);
    const split = isHybrid ? decompose(this.medium, millimetres) : { radius: 0, steepness: 1 };
    this.isHybrid = split.radius > 0;
    this.skyApart = this.isHybrid && skyApart;
    const sizes = constants.discSizes;
    const discs = {
      even: constants.evenWithin,
      smallest: constants.smallestDisc,
      largest: constants.largestDisc * body.extent,
      sizes,
      steepest: constants.steepestCurve,
    };
    const farDiscs = { ...discs, largest: discs.largest * constants.farDisc };
    const make = (/** @type {typeof discs} */ some, /** @type {(r: number) => number} */ weight) =>
      this.profiles.make(/** @type {Medium} */ (this.medium), body.extent, some, weight);
    const all = this.isHybrid && !this.skyApart ? null : make(discs, () => 1);
    const main = this.isHybrid ? make(farDiscs, far(split)) : /** @type {ProfileRows} */ (all);
    const nearRows = this.isHybrid ? make({ ...discs, largest: 0 }, near(split)) : main;
    this.rows = { main, near: nearRows, sky: all ?? main };
    this.device.free(this.ringPlaces);
    const found = this.isHybrid ? rings(this.medium, split) : { places: new Float32Array(4), count: 0 };
    this.ringPlaces = this.device.upload(Math.max(found.count, 1), 1, found.places);
    this.ringCount = found.count;
  }

  /** @param {State} state */
  updateLight(state) {
    const { body, memory } = this;
    const { lamps, hybrid, sky, medium } = state;
    const count = Math.max(lamps.length, 1);
    if (this.shadow.allocate(count)) memory.keys.clear();
    this.views = lamps.map((lamp) => lampView(lamp, body.centre, body.radius));
    lamps.forEach(({ kind, position }, k) => {
      if (memory.changed(`shadow ${k}`, [kind, position])) this.shadow.draw(k, this.views[k]);
    });
    this.updateProfile(state);
    const colour = body.maps.hasColour ? /** @type {Medium} */ (this.medium).reflectance : [1, 1, 1];
    if (this.nearMap.allocate(this.isHybrid ? count : 1)) lamps.forEach((_, k) => memory.keys.delete(`near map ${k}`));
    lamps.forEach((lamp, k) => {
      if (!this.isHybrid || !memory.changed(`near map ${k}`, [lamp, medium.eta, hybrid, colour])) return;
      const values = { lamp: placed(lamp), spectrum: spectrum(lamp), eta: medium.eta, reflectance: colour };
      this.nearMap.draw(k, this.views[k], values);
    });
    if (memory.changed("sky", sky)) body.setSky(sky, this.constants.opennessScale);
    if (!memory.changed("irradiance", [lamps, sky, medium.eta, colour])) return;
    this.irradiance.draw({ ...this.lampValues(state), eta: medium.eta, reflectance: colour });
    this.pyramid.draw();
  }

  /** @param {State} state @param {number} pass */
  updateSamples(state, pass) {
    const { rows, constants, memory } = this;
    const inputs = [state.lamps, state.sky, state.medium, state.millimetres, state.samples, this.isHybrid, this.skyApart, pass];
    if (!memory.changed("samples", inputs)) return;
    const { body } = this;
    this.samples.draw(state.samples, {
      ...body.maps,
      sums: this.irradiance.sums,
      power: this.irradiance.power,
      levels: this.irradiance.levels,
      shift: this.shifts[pass % this.shifts.length],
      skyApart: Number(this.skyApart),
      reflectance: body.maps.hasColour ? /** @type {Medium} */ (this.medium).reflectance : [1, 1, 1],
      smallest: [rows.main.smallest, rows.sky.smallest],
      rows: [rows.main.rows, rows.sky.rows],
      shrink: [this.isHybrid ? constants.farDisc : 1, 1],
      overlap: constants.overlap,
    });
  }

  /** @param {State} state @returns {Values} */
  lampValues({ lamps }) {
    return {
      shadows: /** @type {Texture} */ (this.shadow.maps),
      lampMatrices: ofLamps(
        this.views.map((view) => view.matrix),
        16,
      ),
      lamps: ofLamps(lamps.map(placed), 4),
      spectra: ofLamps(lamps.map(spectrum), 3),
      lampCount: lamps.length,
      bias: BIAS * this.body.radius,
    };
  }

  /** @param {State} state @param {number} pass @returns {Values} */
  gatherValues(state, pass) {
    const { rows, views } = this;
    return {
      ...this.samples.values,
      sampleCount: state.samples,
      profile: rows.main.texture,
      skyProfile: rows.sky.texture,
      nearProfile: rows.near.texture,
      toColumn: columns(rows.main),
      skyToColumn: columns(rows.sky),
      nearToColumn: columns(rows.near),
      skyApart: Number(this.skyApart),
      mostMu: /** @type {Medium} */ (this.medium).extinction / (2 * this.constants.tightest),
      nearMaps: /** @type {Texture} */ (this.nearMap.maps),
      nearSlopes: /** @type {Texture} */ (this.nearMap.slopes),
      ringPlaces: this.ringPlaces,
      ringCount: this.ringCount,
      ringTurn: [Math.cos(pass * TURN), Math.sin(pass * TURN)], // so that the mean of passes has not the pattern of one
      mapCount: this.isHybrid ? views.length : 0,
      mapRight: ofLamps(
        views.map((view) => view.right),
        3,
      ),
      mapUp: ofLamps(
        views.map((view) => view.up),
        3,
      ),
      mapAxis: ofLamps(
        views.map((view) => view.axis),
        3,
      ),
      mapCentre: this.body.centre,
      mapScale: ofLamps(
        views.map((view) => [this.nearMap.zoom(view), view.parallel ? 0 : 1 / view.distance]),
        2,
      ),
    };
  }

  // ---------------------------------------------------------------- stage 3: the picture

  /** @param {State} state @returns {number} pairs of a point and a sample, or a place of the filter, that a sum has */
  pairsPerPoint(state) {
    return state.samples * (this.skyApart ? 2 : 1) + this.ringCount * (this.isHybrid ? state.lamps.length : 0);
  }

  /**
   * Make a picture, in steps between which the caller may let others draw: of so many pairs each.
   * @param {State} state @param {Camera} camera @param {number} width @param {number} height
   * @param {Mode} mode @param {number} pass 0 looks through the middle of the pixels; later ones are averaged with it
   * @param {number} [pairsAtOnce]
   * @returns {Generator<void>}
   */
  *picture(state, camera, width, height, mode, pass, pairsAtOnce = Infinity) {
    const { body, memory } = this;
    this.updateLight(state);
    this.updateSamples(state, pass);
    const gather = this.gatherValues(state, pass);
    const light = [memory.keys.get("samples"), memory.keys.get("profile")];
    if (mode === "vertices" && memory.changed("vertices", light)) {
      yield* this.sum("vertices", { ...gather, ...body.vertexValues }, 1, state, pairsAtOnce);
    }
    const view = viewOf(camera, width, height, body);
    this.matrix = view.matrix;
    this.surface.allocate(width, height);
    this.composite.allocate(width, height);
    const jitter = R2.map((step, k) => (-2 * (((0.5 + pass * step) % 1) - 0.5)) / [width, height][k]);
    if (
      memory.changed("surface", [camera, width, height, jitter, state.floor, mode === "vertices", mode === "vertices" && light])
    ) {
      const exitances = mode === "vertices" ? /** @type {Texture} */ (this.vertices.exitance) : null;
      this.surface.draw(view.matrix, jitter, exitances, state.floor ? this.floor : null);
    }
    const stride = STRIDES[mode];
    this.pixels.allocate(width, height, stride);
    const values = { ...gather, ...this.surface.values };
    if (mode !== "vertices" && memory.changed("pixels", [memory.keys.get("surface"), light, stride])) {
      yield* this.sum("pixels", values, stride, state, pairsAtOnce);
    }
    this.show(state, camera, values, view, mode, pass);
  }

  /**
   * Sum row by row; who ends this before its end is not taken at its word that the sums are there.
   * @param {"pixels" | "vertices"} where @param {Values} values @param {number} stride @param {State} state @param {number} pairsAtOnce
   */
  *sum(where, values, stride, state, pairsAtOnce) {
    const pass = this[where];
    const [width, rows] = /** @type {number[]} */ (pass.size);
    const perRow = width * this.pairsPerPoint(state);
    const step = Math.max(1, Math.min(rows, Math.floor(pairsAtOnce / perRow)));
    let first = 0;
    try {
      for (; first < rows; first += step) {
        if (first > 0) yield;
        pass.draw(values, stride, first, first + step);
        this.pairs += perRow * Math.min(step, rows - first);
      }
    } finally {
      if (first < rows) this.memory.keys.delete(where);
    }
  }

  /**
   * @param {State} state @param {Camera} camera @param {Values} values @param {ReturnType<typeof viewOf>} view
   * @param {Mode} mode @param {number} pass
   */
  show(state, camera, values, view, mode, pass) {
    const { gl } = this.device;
    const exitances = /** @type {Texture} */ (mode === "vertices" ? this.surface.summed : this.pixels.exitance);
    if (state.autoExposure) {
      gl.bindTexture(gl.TEXTURE_2D, exitances.handle);
      gl.generateMipmap(gl.TEXTURE_2D);
    }
    const medium = /** @type {Medium} */ (this.medium);
    this.composite.draw(
      {
        ...values,
        ...this.lampValues(state),
        exitances,
        sums: this.irradiance.sums,
        levels: this.irradiance.levels,
        topLevel: topLevel(exitances),
        autoExposure: Number(state.autoExposure),
        stride: STRIDES[mode],
        stops: state.stops,
        eye: camera.origin,
        background: state.background,
        pixelSize: [view.pixel, this.body.radius],
        floorColour: this.constants.floorColour,
        eta: medium.eta,
        leave: 1 / (Math.PI * medium.transmittance),
        area: this.body.area,
        highlight: state.highlight,
        shininess: 2 / Math.max(state.roughness, 0.02) ** 2,
        hasSky: Number(state.sky !== null),
        skyRadiance: Float32Array.from(state.sky?.flat() ?? NO_SKY),
        forward: view.forward,
        rightward: times(view.right, view.halfWidth),
        upward: times(view.up, view.halfHeight),
      },
      pass,
    );
    this.composite.present();
    if (state.dots) this.dots.draw({ ...values, matrix: view.matrix, eye: camera.origin }, state.samples);
  }

  /**
   * Make a whole picture at once.
   * @param {State} state @param {Camera} camera @param {number} width @param {number} height @param {Mode} [mode] @param {number} [pass]
   */
  frame(state, camera, width, height, mode = "pixels", pass = 0) {
    for (const step of this.picture(state, camera, width, height, mode, pass)) void step;
  }

  /**
   * The radiance that the last picture shows as one half, before exposure by stops (tone.py): waits for the device.
   * @param {State} state
   */
  half(state) {
    const { exitance } = this.pixels;
    const [flux] = this.device.read(this.irradiance.sums, this.irradiance.levels);
    const [r, g, b, covered] = exitance ? this.device.read(exitance, topLevel(exitance)) : [0, 0, 0, 0];
    const mean = (0.212671 * r + 0.71516 * g + 0.072169 * b) / covered / Math.PI / AUTOMATIC;
    if (state.autoExposure && covered > 1e-4) return Math.max(mean, 1e-20);
    return flux > 0 ? flux / (Math.PI * this.body.area) : 1;
  }

  /** The part of the pixels that show the body, as summed last: a texel is read back, which waits for the device. */
  covered() {
    const { exitance } = this.pixels;
    if (!exitance) return 0;
    this.device.gl.bindTexture(this.device.gl.TEXTURE_2D, exitance.handle);
    this.device.gl.generateMipmap(this.device.gl.TEXTURE_2D);
    return this.device.read(exitance, topLevel(exitance))[3];
  }
}

/** The level of a mipmapped texture that is one texel. @param {Texture} texture */
const topLevel = ({ width, height }) => Math.floor(Math.log2(Math.max(width, height)));

/**
 * Write numbers of each lamp behind each other, for as many lamps as shaders have.
 * @param {number[][]} values @param {number} size of each
 */
const ofLamps = (values, size) =>
  Float32Array.from({ length: size * MOST_LAMPS }, (_, k) => values[Math.floor(k / size)]?.[k % size] ?? 0);
/** @param {ProfileRows} rows @returns {number[]} */
const columns = ({ perSquare, slope, start, unscale }) => [perSquare, slope, start, unscale];
/** @param {Lamp} lamp @returns {number[]} */
const placed = ({ kind, position }) => [...position, kind === "directional" ? 0 : 1];
/** @param {Lamp} lamp @returns {number[]} */
const spectrum = ({ colour, intensity }) => times(colour, intensity);
