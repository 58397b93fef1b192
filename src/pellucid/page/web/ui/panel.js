// The controls of light, picture and method.

import { add, subtract, times, unit } from "../vectors.js";
import { MOST_LAMPS } from "../engine.js";
import { choices, element, fromHex, showOutputs, toHex } from "./controls.js";
import { SKY_NAMES } from "./sky.js";
import { turnLamp } from "./view.js";

/** @import { Lamp } from "../passes/shadow.js" */
/** @import { PageState } from "./state.js" */
/** @import { Vector } from "../vectors.js" */

const stops = (/** @type {number} */ value) => `${value > 0 ? "+" : ""}${value.toFixed(1)} stops`;

const OUTPUTS = /** @type {Record<string, (value: number) => string>} */ ({
  share: (value) => `${Math.round(100 * value)} %`,
  size: (value) => `${Number((10 ** value).toPrecision(3))} mm`,
  eta: (value) => value.toFixed(2),
  g: (value) => value.toFixed(2),
  lampStops: stops,
  lampDistance: (value) => `${(2 ** value).toFixed(1)} radii`,
  skyStops: stops,
  skyTurn: (value) => `${value}°`,
  stops,
  highlight: (value) => value.toFixed(2),
  roughness: (value) => value.toFixed(2),
  samples: (value) => String(Math.round(2 ** value)),
});

/** Sliders and boxes, each with the field of the state that it sets, and how. */
const FIELDS =
  /** @type {Record<string, {get: (state: PageState) => number | string | boolean, set: (state: PageState, value: any) => void}>} */ ({
    size: {
      get: (state) => Math.log10(state.millimetres),
      set: (state, value) => (state.millimetres = Number((10 ** value).toPrecision(4))),
    },
    sky: { get: (state) => state.sky, set: (state, value) => (state.sky = value) },
    skyStops: { get: (state) => state.skyStops, set: (state, value) => (state.skyStops = value) },
    skyTurn: { get: (state) => state.skyTurn, set: (state, value) => (state.skyTurn = value) },
    floor: { get: (state) => state.floor, set: (state, value) => (state.floor = value) },
    autoExposure: { get: (state) => state.autoExposure, set: (state, value) => (state.autoExposure = value) },
    stops: { get: (state) => state.stops, set: (state, value) => (state.stops = value) },
    highlight: { get: (state) => state.highlight, set: (state, value) => (state.highlight = value) },
    roughness: { get: (state) => state.roughness, set: (state, value) => (state.roughness = value) },
    method: { get: (state) => (state.hybrid ? "hybrid" : "plain"), set: (state, value) => (state.hybrid = value === "hybrid") },
    samples: { get: (state) => Math.log2(state.samples), set: (state, value) => (state.samples = Math.round(2 ** value)) },
    mode: { get: (state) => state.mode, set: (state, value) => (state.mode = value) },
    dots: { get: (state) => state.dots, set: (state, value) => (state.dots = value) },
  });

export class Panel {
  /**
   * @param {any} head of the file @param {{centre: Vector, radius: number}} body
   * @param {() => PageState} state @param {() => void} changed
   */
  constructor(head, body, state, changed) {
    this.body = body;
    this.state = state;
    this.changed = changed;
    this.lamp = 0;
    /** Brightness of a lamp at 0 stops, at the middle of the body. */
    this.reference = this.referenceOf(head.state.lamps);
    const skies = SKY_NAMES.map((name) => [name, name]);
    choices("sky", [["none", "dark"], ...(head.state.sky ? [["scene", "that of the scene"]] : []), ...skies]);
    for (const [id, { set }] of Object.entries(FIELDS)) {
      element(id).addEventListener("input", () => this.edit(() => set(state(), valueOf(element(id)))));
    }
    element("lamp").addEventListener("input", () => this.choose(Number(element("lamp").value)));
    this.onLamp("lampColour", (lamp, value) => (lamp.colour = brightest(fromHex(value))));
    this.onLamp("lampStops", (lamp, value) => this.brighten(lamp, this.reference * 2 ** Number(value)));
    this.onLamp("lampDistance", (lamp, value) => this.move(lamp, 2 ** Number(value)));
    this.onLamp("lampKind", (lamp, value) => this.turnInto(lamp, value));
    element("addLamp").addEventListener("click", () => this.edit(() => this.add()));
    element("removeLamp").addEventListener("click", () => this.edit(() => this.remove()));
  }

  /** @param {() => void} act */
  edit(act) {
    act();
    this.show();
    this.changed();
  }

  /** @param {string} id @param {(lamp: Lamp, value: string) => void} act */
  onLamp(id, act) {
    element(id).addEventListener("input", () => {
      const lamp = this.state().lamps[this.lamp];
      if (lamp) this.edit(() => act(lamp, element(id).value));
    });
  }

  // ---------------------------------------------------------------- lamps

  /** Irradiance of a lamp at the middle of the body. @param {Lamp} lamp */
  strength(lamp) {
    return lamp.kind === "directional"
      ? lamp.intensity
      : lamp.intensity / Math.hypot(...subtract(lamp.position, this.body.centre)) ** 2;
  }

  /** @param {Lamp[]} lamps */
  referenceOf(lamps) {
    return Math.max(...lamps.map((lamp) => this.strength(lamp)), 0) || 1;
  }

  /** @param {Lamp} lamp @param {number} irradiance */
  brighten(lamp, irradiance) {
    lamp.intensity =
      lamp.kind === "directional" ? irradiance : irradiance * Math.hypot(...subtract(lamp.position, this.body.centre)) ** 2;
  }

  /** Move a lamp away, as bright at the body as before. @param {Lamp} lamp @param {number} radii */
  move(lamp, radii) {
    if (lamp.kind === "directional") return;
    const strength = this.strength(lamp);
    lamp.position = add(this.body.centre, times(unit(subtract(lamp.position, this.body.centre)), radii * this.body.radius));
    this.brighten(lamp, strength);
  }

  /** @param {Lamp} lamp @param {string} kind */
  turnInto(lamp, kind) {
    const strength = this.strength(lamp);
    const way = lamp.kind === "directional" ? lamp.position : subtract(lamp.position, this.body.centre);
    lamp.position = kind === "directional" ? unit(way) : add(this.body.centre, times(unit(way), 4 * this.body.radius));
    lamp.kind = kind === "directional" ? "directional" : "point";
    this.brighten(lamp, strength);
  }

  add() {
    const { lamps, camera } = this.state();
    if (lamps.length >= MOST_LAMPS) return;
    const above = add(subtract(camera.origin, camera.target), times(camera.up, 2 * this.body.radius));
    /** @type {Lamp} */
    const lamp = {
      kind: "point",
      position: add(this.body.centre, times(unit(above), 4 * this.body.radius)),
      colour: [1, 1, 1],
      intensity: 1,
    };
    turnLamp(lamp, camera, this.body.centre, lamps.length, 0);
    this.brighten(lamp, this.reference);
    lamps.push(lamp);
    this.lamp = lamps.length - 1;
  }

  remove() {
    this.state().lamps.splice(this.lamp, 1);
    this.lamp = Math.max(0, this.lamp - 1);
  }

  /** @param {number} lamp */
  choose(lamp) {
    if (lamp === this.lamp) return;
    this.lamp = lamp;
    this.show();
    this.changed();
  }

  // ---------------------------------------------------------------- the state in all controls

  show() {
    const state = this.state();
    for (const [id, { get }] of Object.entries(FIELDS)) {
      const [control, value] = [element(id), get(state)];
      if (typeof value === "boolean") control.checked = value;
      else control.value = String(value);
    }
    this.lamp = Math.min(this.lamp, Math.max(state.lamps.length - 1, 0));
    choices(
      "lamp",
      state.lamps.map(({ kind }, k) => [String(k), `${k + 1}, ${kind === "point" ? "a point" : "far away"}`]),
    );
    const lamp = state.lamps[this.lamp];
    for (const id of ["lamp", "lampColour", "lampStops", "lampDistance", "lampKind", "removeLamp"]) element(id).disabled = !lamp;
    element("addLamp").disabled = state.lamps.length >= MOST_LAMPS;
    if (lamp) {
      element("lamp").value = String(this.lamp);
      element("lampColour").value = toHex(lamp.colour);
      element("lampStops").value = String(Math.log2(Math.max(this.strength(lamp), 1e-30) / this.reference));
      element("lampKind").value = lamp.kind;
      element("lampDistance").disabled = lamp.kind === "directional";
      if (lamp.kind === "point")
        element("lampDistance").value = String(
          Math.log2(Math.hypot(...subtract(lamp.position, this.body.centre)) / this.body.radius),
        );
    }
    for (const label of document.querySelectorAll(".ofSky")) {
      /** @type {HTMLElement} */ (label).hidden = state.sky === "none";
    }
    this.showOutputs();
  }

  showOutputs() {
    showOutputs(OUTPUTS);
    const size = /** @type {HTMLOutputElement} */ (document.querySelector('output[for="size"]'));
    size.value = `${Number(this.state().millimetres.toPrecision(3))} mm`; // a slider has limits, the size has none
  }
}

/** @param {HTMLInputElement} control */
function valueOf(control) {
  if (control.type === "checkbox") return control.checked;
  return control.type === "range" ? Number(control.value) : control.value;
}

/** @param {Vector} colour @returns {Vector} of which the largest is 1 */
const brightest = (colour) => times(colour, 1 / Math.max(...colour, 1e-6));
