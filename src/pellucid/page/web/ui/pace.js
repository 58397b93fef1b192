// How much a device can do: pairs of points and samples a second, measured, and what a frame may hold.

import { MODES } from "../engine.js";

/** @import { Engine, Mode, State } from "../engine.js" */

const FRAME = 0.016; // seconds
const FOR_SUMS = 0.75; // of a frame
const MEASURED = 0.02; // seconds that are enough to measure
const FALLBACK = 0.1; // of the pixels have no coarse sum to interpolate between
const STRIDES = { pixels: 1, quarter: 2, sixteenth: 4, vertices: 1 };

/**
 * Count the pairs of a frame.
 * @param {Mode} mode @param {number} pixels that show the body @param {number} vertices @param {number} perPoint pairs of a sum
 */
export function pairsOf(mode, pixels, vertices, perPoint) {
  if (mode === "vertices") return vertices * perPoint;
  const stride = STRIDES[mode];
  return pixels * (stride === 1 ? 1 : 1 / stride ** 2 + FALLBACK) * perPoint;
}

/**
 * Choose where to sum: at every pixel if a frame has time for it, else at fewer; at last at the vertices.
 * @param {number} rate pairs a second @param {number} pixels that show the body @param {number} vertices @param {number} perPoint
 * @returns {Mode}
 */
export function chooseMode(rate, pixels, vertices, perPoint) {
  const room = rate * FRAME * FOR_SUMS;
  const cost = (/** @type {Mode} */ mode) => pairsOf(mode, pixels, vertices, perPoint);
  return MODES.find((mode) => cost(mode) <= room) ?? (cost("vertices") < cost("sixteenth") ? "vertices" : "sixteenth");
}

export class Pace {
  constructor() {
    /** Pairs a second. */
    this.rate = 1e9;
    /** The part of the picture that shows the body. */
    this.covered = 0.25;
  }

  /** Sum at the vertices until that takes long enough to be measured. @param {Engine} engine @param {State} state */
  measure(engine, state) {
    const { device, body, vertices } = engine;
    engine.updateLight(state);
    engine.updateSamples(state, 0);
    const values = { ...engine.gatherValues(state, 0), ...body.vertexValues };
    const rows = body.vertexPlaces.height;
    const finish = () => device.read(/** @type {import("../device.js").Texture} */ (vertices.exitance)); // waits for the device
    vertices.draw(values, 1, 0, 1);
    finish(); // compiled
    for (let times = 1; ; times *= 4) {
      const begin = performance.now();
      for (let k = 0; k < times; k++) vertices.draw(values, 1, 0, rows);
      finish();
      const seconds = (performance.now() - begin) / 1000;
      this.rate = (times * body.vertices * engine.pairsPerPoint(state)) / Math.max(seconds, 1e-4);
      if (seconds > MEASURED || times >= 1024) return;
    }
  }

  /** Learn from a frame; one that was faster than the screen says only that there was time left. @param {number} pairs @param {number} seconds */
  learn(pairs, seconds) {
    if (pairs === 0) return;
    const rate = pairs / seconds;
    if (seconds > 1.5 * FRAME || rate > this.rate) this.rate += 0.2 * (rate - this.rate);
  }

  /** @param {Engine} engine @param {State} state @param {number} width @param {number} height */
  mode(engine, state, width, height) {
    return chooseMode(this.rate, this.covered * width * height, engine.body.vertices, engine.pairsPerPoint(state));
  }
}
