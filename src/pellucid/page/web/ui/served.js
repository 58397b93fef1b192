// What the page can do where Python serves it: comparison with two-pass, scenes for Mitsuba, other meshes.

import { element } from "./controls.js";
import { settledPicture } from "./keep.js";

/** @import { Engine, State } from "../engine.js" */
/** @import { Camera } from "../framing.js" */
/** @import { PageState } from "./state.js" */

const PERIOD = 300; // milliseconds between two questions how far a comparison is
const MOST_PIXELS = 1 << 20;

/**
 * What is needed of the page.
 * @typedef {object} Served
 * @property {PageState} state @property {Engine} engine @property {HTMLCanvasElement} canvas
 * @property {() => State} forEngine @property {(aspect: number) => Camera} cameraFor
 * @property {(width: number, height: number, make: () => Promise<Shown>) => Promise<Shown>} apart
 * @property {{size: () => [number, number], pace: {rate: number}}} loop
 * @property {(id: string, act: () => unknown) => void} onClick
 */

/**
 * A picture, tone-mapped, and what it took for one half: rows from the bottom up, four numbers a pixel.
 * @typedef {{values: Float32Array, half: number}} Shown
 */

/**
 * Ask the server.
 * @param {string} path @param {unknown} [body]
 * @returns {Promise<Response>}
 */
async function ask(path, body) {
  const token = new URLSearchParams(location.search).get("token") ?? "";
  const headers = { Authorization: `Bearer ${token}`, "Content-Type": "application/json" };
  const sent = body === undefined ? {} : { method: "POST", body: JSON.stringify(body), keepalive: true };
  const response = await fetch(path, { headers, ...sent });
  if (!response.ok) {
    const { error } = await response.json().catch(() => ({ error: `The server answers ${response.status}.` }));
    throw new Error(error);
  }
  return response;
}

/** @param {string} text */
function note(text) {
  /** @type {HTMLElement} */ (document.getElementById("serverNote")).textContent = text;
}

/** Connect the buttons with the server. @param {Served} page */
export function connect(page) {
  /** @type {HTMLElement} */ (document.getElementById("served")).hidden = false;
  let isRunning = false;
  page.onClick("compare", async () => {
    if (isRunning) return ask("/stop", {});
    isRunning = true;
    element("compare").textContent = "Stop the comparison";
    try {
      await compare(page);
    } finally {
      isRunning = false;
      element("compare").textContent = "Compare with two-pass";
    }
  });
  addEventListener("pagehide", () => isRunning && ask("/stop", {})); // nobody is there to see it
  page.onClick("saveScene", async () => {
    const [width, height] = page.loop.size();
    const { path } = await (await ask("/scene", described(page, width, height))).json();
    note(`Wrote ${path}: pellucid view ${path} shows it again, pellucid render ${path} renders it.`);
  });
  page.onClick("open", async () => {
    note("Opening …");
    try {
      await ask("/open", { path: element("openPath").value });
    } catch (error) {
      note("");
      throw error;
    }
    location.hash = "";
    location.reload();
  });
}

/** @param {Served} page @param {number} width @param {number} height */
function described(page, width, height) {
  return { ...page.state, sky: page.forEngine().sky, camera: page.cameraFor(width / height), width, height };
}

/** @param {Served} page */
async function compare(page) {
  let [width, height] = page.loop.size();
  const smaller = Math.min(1, Math.sqrt(MOST_PIXELS / (width * height)));
  [width, height] = [Math.floor(width * smaller), Math.floor(height * smaller)];
  const asked = described(page, width, height);
  const state = { ...page.forEngine(), highlight: 0, dots: false };
  const shown = await page.apart(width, height, async () => {
    await ask("/comparison", asked);
    await settledPicture(page.engine, state, asked.camera, width, height, page.loop.pace.rate * 0.1, undefined, 1);
    const { picture } = page.engine.composite;
    return {
      values: page.engine.device.read(/** @type {import("../device.js").Texture} */ (picture)),
      half: page.engine.half(state),
    };
  });
  for (;;) {
    const progress = await (await ask("/comparison")).json();
    if (progress.state === "done") break;
    if (progress.state !== "running") throw new Error(progress.error ? `It failed: ${progress.error}` : "Stopped.");
    note(`Two-pass: ${progress.stage}, ${Math.round(100 * progress.share)} %`);
    await new Promise((resolve) => setTimeout(resolve, PERIOD));
  }
  note("");
  const reference = new Float32Array(await (await ask("/comparison/picture")).arrayBuffer());
  present(shown, reference, width, height, state.stops);
}

/**
 * Show a picture, its reference, and their difference, with the same exposure.
 * @param {Shown} shown @param {Float32Array} reference radiance, rows from the top down; the fourth number tells where the body is
 * @param {number} width @param {number} height @param {number} stops
 */
function present({ values, half }, reference, width, height, stops) {
  const scale = 2 ** stops / half;
  const [view, twoPass, difference] = [0, 1, 2].map(() => new Float32Array(4 * width * height));
  let [square, count, largest] = [0, 0, 1e-3];
  for (let pixel = 0; pixel < width * height; pixel++) {
    const row = height - 1 - Math.floor(pixel / width);
    if (reference[4 * pixel + 3] === 0) continue;
    count++;
    for (let k = 0; k < 3; k++) {
      const scaled = reference[4 * pixel + k] * scale;
      view[4 * pixel + k] = values[4 * (row * width + (pixel % width)) + k];
      twoPass[4 * pixel + k] = scaled / (1 + scaled);
      difference[4 * pixel + k] = Math.abs(view[4 * pixel + k] - twoPass[4 * pixel + k]);
      square += difference[4 * pixel + k] ** 2;
      largest = Math.max(largest, difference[4 * pixel + k]);
    }
  }
  const error = Math.sqrt(square / Math.max(3 * count, 1));
  const factor = 2 ** Math.floor(Math.log2(0.5 / Math.max(error, 0.5 * Math.min(largest, 0.01))));
  const pictures = document.getElementById("pictures");
  pictures?.replaceChildren(
    figure("This view", view, width, height, 1),
    figure("Two-pass", twoPass, width, height, 1),
    figure(`Difference × ${factor}`, difference, width, height, factor),
  );
  const text = `RMSE ${error.toFixed(4)} of tone-mapped pictures in [0, 1], on the ${count} pixels that show the body`;
  /** @type {HTMLElement} */ (document.getElementById("comparisonText")).textContent = text;
  /** @type {HTMLDialogElement} */ (document.getElementById("comparison")).showModal();
}

/**
 * @param {string} caption @param {Float32Array} values @param {number} width @param {number} height @param {number} factor
 */
function figure(caption, values, width, height, factor) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const bytes = Uint8ClampedArray.from(values, (value, k) => (k % 4 === 3 ? 255 : 255 * factor * value));
  canvas.getContext("2d")?.putImageData(new ImageData(bytes, width, height), 0, 0);
  const result = document.createElement("figure");
  result.append(Object.assign(document.createElement("figcaption"), { textContent: caption }), canvas);
  return result;
}
