// A translucent medium, from the table of all media that the exporter made (page/medium_table.py).

/** @import { Vector } from "./vectors.js" */

/**
 * @typedef {object} MediumTable
 * @property {Float32Array} profile log(R_d / a') + k d, by g, index of refraction, albedo and distance
 * @property {Float32Array} reflectance R / a'
 * @property {Float32Array} decay k, the reduced over the diffuse mean free path, by g and albedo
 * @property {Float32Array} transmittance T_d
 * @property {Float32Array | null} curve beta, by index of refraction, albedo and distance; null of the profile of a flat body
 * @property {number} bends distances of beta, an octave apart @property {number} firstBend
 * @property {number} nearest distance within which a profile is its mean [mean free paths]
 * @property {number[]} g mean cosines of the scattering angle
 * @property {number} etas @property {number} firstEta @property {number} etaStep
 * @property {number} albedos @property {number} steepest
 * @property {number} distances @property {number} firstOctave @property {number} perOctave
 */

/**
 * Find the table among what the exporter packed.
 * @param {any} head its axes @param {import("./data.js").Planes} planes
 * @returns {MediumTable}
 */
export function readTable(head, planes) {
  const plane = (/** @type {string} */ name) => /** @type {Float32Array} */ (planes[`table.${name}`]);
  const levels = (/** @type {string} */ name) => {
    const { low, step } = head.levels[name];
    return Float32Array.from(plane(name), (level) => low + step * level);
  };
  return {
    ...head,
    profile: levels("profile"),
    curve: head.levels.curve ? levels("curve") : null,
    reflectance: plane("reflectance"),
    decay: plane("decay"),
    transmittance: plane("transmittance"),
  };
}

/**
 * Reduced scattering and absorption by channel [1/mm], the index of refraction, the mean cosine of the scattering angle.
 * @typedef {{scattering: Vector, absorption: Vector, eta: number, g: number}} Coefficients
 */

/**
 * Weigh four neighbours of a place between entries, by Catmull and Rom's cubic; at the ends by the nearest three.
 * @param {number} place counted in entries @param {number} count
 * @returns {[number, number][]} entries and their weights
 */
export function cubic(place, count) {
  const first = Math.min(Math.max(Math.floor(place), 0), count - 2);
  const t = Math.min(Math.max(place - first, 0), 1);
  const weights = [
    -0.5 * t * (1 - t) * (1 - t),
    1 + t * t * (1.5 * t - 2.5),
    t * (0.5 + t * (2 - 1.5 * t)),
    -0.5 * t * t * (1 - t),
  ];
  // Beyond an end the cubic goes on as a parabola through the last three.
  if (first === 0) {
    weights[1] += 3 * weights[0];
    weights[2] -= 3 * weights[0];
    weights[3] += weights[0];
    weights[0] = 0;
  }
  if (first === count - 2) {
    weights[2] += 3 * weights[3];
    weights[1] -= 3 * weights[3];
    weights[0] += weights[3];
    weights[3] = 0;
  }
  return weights
    .map((weight, k) => /** @type {[number, number]} */ ([first - 1 + k, weight]))
    .filter(([, weight]) => weight !== 0);
}

/** One channel of a medium: its albedo, its extinction per scene unit, and its profile. */
class Channel {
  /**
   * @param {MediumTable} table
   * @param {number} albedo a' @param {number} extinction sigma_t' @param {number} eta @param {number} g
   */
  constructor(table, albedo, extinction, eta, g) {
    this.table = table;
    this.albedo = albedo;
    this.extinction = extinction;
    const s = Math.sqrt(3 * (1 - albedo));
    this.cells = cells(table, s, eta, g);
    this.decay = decayOf(table, s, g);
    this.smooth = Float64Array.from({ length: table.distances }, (_, d) =>
      sum(this.cells, ([cell, weight]) => weight * table.profile[cell * table.distances + d]),
    );
    const { curve, bends } = table;
    const around = together(etas(table, eta), albedos(table, s), table.albedos);
    /** Beta at its distances, of a curved profile. */
    this.bent =
      curve && Array.from({ length: bends }, (_, d) => sum(around, ([cell, weight]) => weight * curve[cell * bends + d]));
  }

  /**
   * Beta: where the surface curves the profile is R_d exp(beta mu), mu the cosine between the normal where light leaves and the
   * way there from where it enters (model/flat_profile.py).
   * @param {number} r distance [scene units]
   */
  curve(r) {
    if (!this.bent) return 0;
    const { bends, firstBend } = this.table;
    const place = Math.min(Math.max(Math.log2(r * this.extinction) - firstBend, 0), bends - 1);
    const k = Math.min(Math.floor(place), bends - 2);
    return this.bent[k] + (place - k) * (this.bent[k + 1] - this.bent[k]);
  }

  /** @param {number} r distance from where light enters [scene units] */
  profile(r) {
    const { firstOctave, perOctave, distances, nearest } = this.table;
    const x = r * this.extinction < nearest ? nearest / 2 : r * this.extinction;
    const place = (Math.log2(x) - firstOctave) * perOctave;
    const y =
      place < 0
        ? this.smooth[0] + place * (this.smooth[1] - this.smooth[0])
        : sum(cubic(place, distances), ([entry, weight]) => weight * this.smooth[entry]);
    return this.albedo * this.extinction ** 2 * Math.exp(y - this.decay * x);
  }

  /** Total diffuse reflectance R. */
  get reflectance() {
    return this.albedo * sum(this.cells, ([cell, weight]) => weight * this.table.reflectance[cell]);
  }
}

/** @type {<T>(items: T[], value: (item: T) => number) => number} */
const sum = (items, value) => items.reduce((total, item) => total + value(item), 0);

/**
 * Weigh all nodes, by the polynomial through them (Lagrange); beyond the ends by that at the ends.
 * @param {number[]} nodes @param {number} x
 * @returns {[number, number][]}
 */
function polynomial(nodes, x) {
  const at = Math.min(Math.max(x, nodes[0]), nodes[nodes.length - 1]);
  return nodes.map((node, k) => [
    k,
    nodes.reduce((product, other, j) => (j === k ? product : (product * (at - other)) / (node - other)), 1),
  ]);
}

/**
 * Weigh entries of two axes together.
 * @param {[number, number][]} rows @param {[number, number][]} columns @param {number} width of a row
 * @returns {[number, number][]}
 */
const together = (rows, columns, width) =>
  rows.flatMap(([row, share]) => columns.map(([k, weight]) => weighed(row * width + k, share * weight)));
/** @param {number} entry @param {number} weight @returns {[number, number]} */
const weighed = (entry, weight) => [entry, weight];

/** @param {MediumTable} table @param {number} s sqrt(3 (1 - a')) */
const albedos = (table, s) => cubic(Math.sqrt(s / table.steepest) * (table.albedos - 1), table.albedos);

/** @param {MediumTable} table @param {number} eta */
const etas = (table, eta) => cubic((eta - table.firstEta) / table.etaStep, table.etas);

/** @param {MediumTable} table @param {number} s sqrt(3 (1 - a')) @param {number} g */
const decayOf = (table, s, g) =>
  sum(together(polynomial(table.g, g), albedos(table, s), table.albedos), ([cell, weight]) => weight * table.decay[cell]);

/**
 * Weigh the entries around a medium.
 * @param {MediumTable} table @param {number} s sqrt(3 (1 - a')) @param {number} eta @param {number} g
 */
function cells(table, s, eta, g) {
  const surfaces = together(polynomial(table.g, g), etas(table, eta), table.etas);
  return together(surfaces, albedos(table, s), table.albedos);
}

/** A medium per scene unit. */
export class Medium {
  /**
   * @param {MediumTable} table
   * @param {Coefficients} coefficients [1/mm]
   * @param {number} millimetres that a scene unit has
   */
  constructor(table, { scattering, absorption, eta, g }, millimetres) {
    this.eta = eta;
    /** Whether the profile follows the curve of the surface. */
    this.isCurved = table.curve !== null;
    this.channels = scattering.map((scattered, k) => {
      const extinction = scattered + absorption[k];
      return new Channel(table, scattered / extinction, extinction * millimetres, eta, g);
    });
    this.shortest = Math.min(...this.channels.map((channel) => 1 / channel.extinction));
    /** T_d: the part of diffuse light that passes the surface from outside. */
    this.transmittance = sum(etas(table, eta), ([e, weight]) => weight * table.transmittance[e]);
  }

  /** @param {number} r [scene units] @returns {Vector} R_d by channel */
  profile(r) {
    return this.channels.map((channel) => channel.profile(r));
  }

  /** @param {number} r [scene units] @returns {Vector} beta by channel */
  curve(r) {
    return this.channels.map((channel) => channel.curve(r));
  }

  /** Mean of the extinction over the channels. */
  get extinction() {
    return sum(this.channels, ({ extinction }) => extinction) / this.channels.length;
  }

  /** @returns {Vector} */
  get reflectance() {
    return this.channels.map((channel) => channel.reflectance);
  }
}

/**
 * Find the coefficients [1/mm] of a medium that has a colour and blurs over a distance, by bisection.
 * @param {MediumTable} table
 * @param {Vector} reflectance R, each below 1 @param {Vector} distance diffuse mean free path [mm]
 * @param {number} eta @param {number} g
 * @returns {Coefficients}
 * Source: JB02 eqs. 15 and 16.
 */
export function fromReflectance(table, reflectance, distance, eta, g) {
  const extinctions = reflectance.map((wanted, k) => {
    let [low, high] = [0, table.steepest * 0.99999];
    for (let step = 0; step < 40; step++) {
      const s = (low + high) / 2;
      const albedo = 1 - (s * s) / 3;
      const value = albedo * sum(cells(table, s, eta, g), ([cell, weight]) => weight * table.reflectance[cell]);
      [low, high] = value > wanted ? [s, high] : [low, s];
    }
    return { albedo: 1 - (low * low) / 3, extinction: 1 / (distance[k] * Math.max(decayOf(table, low, g), 1e-6)) };
  });
  return {
    scattering: extinctions.map(({ albedo, extinction }) => albedo * extinction),
    absorption: extinctions.map(({ albedo, extinction }) => (1 - albedo) * extinction),
    eta,
    g,
  };
}

/**
 * Diffuse mean free paths of a medium [mm].
 * @param {MediumTable} table @param {Coefficients} coefficients
 * @returns {Vector}
 */
export function diffuseDistance(table, { scattering, absorption, g }) {
  return scattering.map((s, k) => {
    const extinction = s + absorption[k];
    return 1 / (extinction * Math.max(decayOf(table, Math.sqrt((3 * absorption[k]) / extinction), g), 1e-6));
  });
}
