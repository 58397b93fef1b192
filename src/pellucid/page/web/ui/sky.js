// Light from all around, as nine spherical harmonics by colour.

import { dot, times, turned } from "../vectors.js";

/** @import { Vector } from "../vectors.js" */

const DIRECTIONS = 512; // enough for products of two of the harmonics

/** Skies: colour from straight above, from the horizon, and from straight below. */
const SKIES = /** @type {Record<string, [Vector, Vector, Vector]>} */ ({
  "an even white": [
    [1, 1, 1],
    [1, 1, 1],
    [1, 1, 1],
  ],
  "an overcast sky": [
    [1.0, 1.04, 1.1],
    [0.5, 0.52, 0.55],
    [0.12, 0.115, 0.11],
  ],
  "a blue sky": [
    [0.35, 0.6, 1.2],
    [0.75, 0.85, 1.0],
    [0.16, 0.14, 0.11],
  ],
  "an evening": [
    [0.16, 0.2, 0.42],
    [1.1, 0.55, 0.26],
    [0.07, 0.055, 0.05],
  ],
});

export const SKY_NAMES = Object.keys(SKIES);

/** @param {Vector} d @returns {number[]} the nine harmonics in a direction */
function harmonics([x, y, z]) {
  const first = [0.282095, 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z];
  return [...first, 0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)];
}

/** @returns {Vector[]} unit vectors, even over all directions */
function directions() {
  return Array.from({ length: DIRECTIONS }, (_, k) => {
    const z = 1 - (2 * k + 1) / DIRECTIONS;
    const angle = Math.PI * (Math.sqrt(5) - 1) * k;
    const across = Math.sqrt(1 - z * z);
    return [across * Math.cos(angle), across * Math.sin(angle), z];
  });
}

/**
 * Project a radiance onto the harmonics.
 * @param {(d: Vector) => Vector} radiance
 * @returns {Vector[]}
 */
function project(radiance) {
  const sums = Array.from({ length: 9 }, () => [0, 0, 0]);
  for (const d of directions()) {
    const colour = radiance(d);
    harmonics(d).forEach((value, k) =>
      colour.forEach((x, channel) => (sums[k][channel] += (x * value * 4 * Math.PI) / DIRECTIONS)),
    );
  }
  return sums;
}

/**
 * Find a sky by its name; null for none.
 * @param {string} name @param {any} head of the file @param {number} brightness
 * @returns {Vector[] | null}
 */
export function skyOf(name, head, brightness) {
  if (name === "scene") return head.state.sky;
  if (!(name in SKIES)) return null;
  const [above, horizon, below] = SKIES[name];
  return project((d) => {
    const height = dot(d, head.camera.up);
    const end = height > 0 ? above : below;
    const share = Math.abs(height) ** 0.7;
    return times(
      horizon.map((x, k) => x * (1 - share) + end[k] * share),
      brightness,
    );
  });
}

/**
 * Turn a sky around an axis.
 * @param {Vector[]} sky @param {number} angle in radians @param {Vector} axis
 */
export function rotatedSky(sky, angle, axis) {
  if (angle === 0) return sky;
  return project((d) => {
    const values = harmonics(turned(d, axis, -angle));
    return [0, 1, 2].map((channel) => values.reduce((sum, value, k) => sum + value * sky[k][channel], 0));
  });
}
