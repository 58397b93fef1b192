// What the page shows, as one object: the link to the page holds it, and everything else is made from it.

import { MODES, MOST_LAMPS } from "../engine.js";
import { SKY_NAMES, rotatedSky, skyOf } from "./sky.js";
import { clamp, cross, subtract, times } from "../vectors.js";

/** @import { Camera } from "../framing.js" */
/** @import { Mode, State } from "../engine.js" */
/** @import { Coefficients } from "../medium.js" */
/** @import { Lamp } from "../passes/shadow.js" */
/** @import { Vector } from "../vectors.js" */

/**
 * @typedef {object} PageState
 * @property {Camera} camera
 * @property {string} material a measured one, or "" @property {string} other to blend it with, or "" @property {number} share of the other
 * @property {Coefficients} medium [1/mm] @property {number} millimetres longest side of the body
 * @property {Lamp[]} lamps @property {string} sky "none", "scene" or the name of one @property {number} skyStops
 * @property {number} skyTurn [degrees] @property {boolean} floor
 * @property {boolean} autoExposure @property {number} stops @property {number} highlight @property {number} roughness
 * @property {boolean} hybrid @property {number} samples N @property {"auto" | Mode} mode @property {boolean} dots
 */

/** Limits of the numbers that a link may bring. */
const LIMITS = /** @type {Record<string, [number, number]>} */ ({
  share: [0, 1],
  millimetres: [1e-3, 1e6],
  samples: [16, 16384],
  stops: [-20, 20],
  skyStops: [-20, 20],
  skyTurn: [-360, 360],
  highlight: [0, 1],
  roughness: [0.02, 1],
  fov: [1, 170],
  eta: [1, 2],
  g: [-0.5, 0.95],
  intensity: [0, 1e30],
});
const COEFFICIENT = [1e-6, 1e6];

/** What the texts of a link may be. @param {any} head of the file @returns {Record<string, string[]>} */
function choicesOf(head) {
  const materials = ["", ...Object.keys(head.materials)];
  const sky = ["none", ...(head.state.sky ? ["scene"] : []), ...SKY_NAMES];
  return { mode: ["auto", ...MODES], sky, material: materials, other: materials };
}

/**
 * @param {any} head of the file
 * @returns {PageState}
 */
export function initialState(head) {
  const { material, medium, millimetres, lamps, sky, samples, hybrid, autoExposure, stops, highlight, roughness, floor } =
    head.state;
  return structuredClone({
    camera: head.camera,
    material,
    other: "",
    share: 0.5,
    medium,
    millimetres,
    lamps,
    sky: sky ? "scene" : "none",
    skyStops: 0,
    skyTurn: 0,
    floor,
    autoExposure,
    stops,
    highlight,
    roughness,
    hybrid,
    samples,
    mode: "auto",
    dots: false,
  });
}

/** @param {unknown} value */
const text = (value) => JSON.stringify(value, rounded);
/** @param {string} _ @param {unknown} value */
const rounded = (_, value) => (typeof value === "number" ? Number(value.toPrecision(5)) : value);

/**
 * Write what differs from the initial state into the fragment of a link.
 * @param {PageState} state @param {PageState} initial
 */
export function toLink(state, initial) {
  const changed = Object.entries(state).filter(
    ([key, value]) => text(value) !== text(initial[/** @type {keyof PageState} */ (key)]),
  );
  return changed.length ? `#${encodeURIComponent(text(Object.fromEntries(changed)))}` : "#";
}

/**
 * Read a link; what does not fit is left as it is initially.
 * @param {string} fragment @param {PageState} initial @param {any} head of the file
 * @returns {PageState}
 */
export function fromLink(fragment, initial, head) {
  const state = structuredClone(initial);
  try {
    const given = JSON.parse(decodeURIComponent(fragment.slice(1)) || "{}");
    take(/** @type {any} */ (state), given, choicesOf(head));
    if (Array.isArray(given.lamps)) state.lamps = given.lamps.slice(0, MOST_LAMPS).map(lampFrom);
  } catch {
    return structuredClone(initial); // a fragment of something else
  }
  const { medium, camera } = state;
  const across = Math.hypot(...cross(subtract(camera.target, camera.origin), camera.up));
  if (!(across > 0)) state.camera = structuredClone(initial.camera); // it looks nowhere
  medium.scattering = medium.scattering.map((value) => clamp(value, COEFFICIENT[0], COEFFICIENT[1]));
  medium.absorption = medium.absorption.map((value) => clamp(value, 0, COEFFICIENT[1]));
  return state;
}

/** @param {any} target @param {any} given @param {Record<string, string[]>} choices */
function take(target, given, choices) {
  for (const [key, value] of Object.entries(given)) {
    const present = target[key];
    if (key === "lamps" || present === undefined) continue;
    if (Array.isArray(present)) {
      if (isVector(value)) target[key] = value;
    } else if (typeof present === "object" && value !== null && typeof value === "object") take(present, value, choices);
    else if (typeof present === "number" && Number.isFinite(value)) target[key] = clamp(value, ...(LIMITS[key] ?? [-1e9, 1e9]));
    else if (typeof present === "boolean" && typeof value === "boolean") target[key] = value;
    else if (choices[key]?.includes(/** @type {string} */ (value))) target[key] = value;
  }
}

/** @param {any} value */
const isVector = (value) =>
  Array.isArray(value) && value.length === 3 && value.every((x) => Number.isFinite(x) && Math.abs(x) < 1e9);

/** @param {any} given @returns {Lamp} */
function lampFrom({ kind, position, colour, intensity }) {
  if (!isVector(position) || !isVector(colour) || Math.hypot(...position) === 0) throw new Error("no lamp");
  return {
    kind: kind === "directional" ? "directional" : "point",
    position,
    colour: colour.map((/** @type {number} */ x) => clamp(x, 0, 1)),
    intensity: clamp(Number(intensity) || 0, 0, 1e30),
  };
}

/**
 * Make what the engine draws; a copy, which stays as it is while a picture is made.
 * @param {PageState} state @param {any} head @param {Vector} background
 * @returns {State}
 */
export function engineState(state, head, background) {
  const sky = skyOf(state.sky, head, reference(head));
  return {
    ...structuredClone(state),
    sky: sky
      ? rotatedSky(sky, (state.skyTurn * Math.PI) / 180, head.camera.up).map((colour) => times(colour, 2 ** state.skyStops))
      : null,
    background,
  };
}

/** The radiance of a white surface under the lamps of the file: skies are about as bright. @param {any} head */
function reference(head) {
  const centre = head.body.low.map((/** @type {number} */ low, /** @type {number} */ k) => low + head.body.size[k] / 2);
  const irradiance = head.state.lamps.map((/** @type {Lamp} */ { kind, position, intensity }) =>
    kind === "directional" ? intensity : intensity / position.reduce((sum, x, k) => sum + (x - centre[k]) ** 2, 0),
  );
  return Math.max(...irradiance, 0) / Math.PI || 1;
}
