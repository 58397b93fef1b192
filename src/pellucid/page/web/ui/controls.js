// What all controls share.

/** @import { Vector } from "../vectors.js" */

/** @param {string} id @returns {HTMLInputElement} a control, by its name in page.html */
export const element = (id) => /** @type {HTMLInputElement} */ (document.getElementById(id));

/** @param {string} id of a select @param {string[][]} options value and text each */
export function choices(id, options) {
  element(id).replaceChildren(...options.map(([value, text]) => new Option(text, value)));
}

/** Write the values of all sliders beside them. @param {Record<string, (value: number) => string>} texts by control */
export function showOutputs(texts) {
  for (const [id, text] of Object.entries(texts)) {
    const output = /** @type {HTMLOutputElement} */ (document.querySelector(`output[for="${id}"]`));
    output.value = text(Number(element(id).value));
    element(id).setAttribute("aria-valuetext", output.value);
  }
}

/** @param {number} x linear in [0, 1] */
const encoded = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
/** @param {number} x sRGB in [0, 1] */
const decoded = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);

/** @param {Vector} colour linear @returns {string} as fields of colours write it */
export const toHex = (colour) =>
  `#${colour
    .map((x) =>
      Math.round(255 * encoded(Math.min(Math.max(x, 0), 1)))
        .toString(16)
        .padStart(2, "0"),
    )
    .join("")}`;

/** @param {string} text @returns {Vector} linear */
export const fromHex = (text) => [1, 3, 5].map((k) => decoded(parseInt(text.slice(k, k + 2), 16) / 255));
