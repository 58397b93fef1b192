// Pictures to keep, of any size.

import { PASSES } from "../engine.js";

/** @import { Camera } from "../framing.js" */
/** @import { Engine, State } from "../engine.js" */

/**
 * Make a settled picture without showing it, and wait between its passes so that the page stays awake.
 * @param {Engine} engine @param {State} state @param {Camera} camera @param {number} width @param {number} height
 * @param {number} pairsAtOnce @param {(share: number) => void} [progress] @param {number} [passes]
 */
export async function settledPicture(engine, state, camera, width, height, pairsAtOnce, progress = () => {}, passes = PASSES) {
  for (let pass = 0; pass < passes; pass++) {
    for (const step of engine.picture(state, camera, width, height, "pixels", pass, pairsAtOnce)) {
      void step;
      await breath();
    }
    progress((pass + 1) / passes);
    await breath();
  }
}

/** @returns {Promise<void>} after the browser has drawn */
const breath = () => new Promise((resolve) => setTimeout(resolve));

/**
 * Offer a file.
 * @param {Blob} blob @param {string} name
 */
export function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/**
 * Write the picture of the canvas as a PNG.
 * @param {HTMLCanvasElement} canvas
 * @returns {Promise<Blob>}
 */
export const asPng = (canvas) =>
  new Promise((resolve, reject) =>
    canvas.toBlob((blob) => (blob ? resolve(blob) : reject(new Error("The picture could not be written."))), "image/png"),
  );
