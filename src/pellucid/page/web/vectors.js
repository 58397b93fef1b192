// Vectors of three numbers, and matrices of sixteen by columns, as WebGL reads them.

/** @typedef {number[]} Vector */

/** @type {(a: Vector, b: Vector) => Vector} */
export const add = (a, b) => a.map((x, i) => x + b[i]);
/** @type {(a: Vector, b: Vector) => Vector} */
export const subtract = (a, b) => a.map((x, i) => x - b[i]);
/** @type {(a: Vector, s: number) => Vector} */
export const times = (a, s) => a.map((x) => x * s);
/** @type {(a: Vector, b: Vector) => number} */
export const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
/** @type {(a: Vector, b: Vector) => Vector} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @type {(a: Vector) => Vector} */
export const unit = (a) => times(a, 1 / (Math.hypot(...a) || 1));
/** @type {(x: number, low: number, high: number) => number} */
export const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

/**
 * Turn a vector around a unit axis, counter-clockwise as seen from its tip.
 * @param {Vector} v @param {Vector} axis @param {number} angle in radians
 * @returns {Vector}
 */
export function turned(v, axis, angle) {
  const c = Math.cos(angle);
  const along = times(axis, dot(axis, v) * (1 - c));
  return add(add(times(v, c), times(cross(axis, v), Math.sin(angle))), along);
}

/**
 * Multiply two matrices.
 * @param {number[]} a @param {number[]} b
 * @returns {number[]}
 */
export function product(a, b) {
  const result = Array.from({ length: 16 }, () => 0);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) result[column * 4 + row] += a[k * 4 + row] * b[column * 4 + k];
    }
  }
  return result;
}

/**
 * Take points of the scene to the space of a camera at `origin`.
 * @param {{right: Vector, up: Vector, back: Vector}} frame @param {Vector} origin
 * @returns {number[]}
 */
export function viewMatrix({ right, up, back }, origin) {
  const columns = [0, 1, 2].flatMap((k) => [right[k], up[k], back[k], 0]);
  return [...columns, -dot(right, origin), -dot(up, origin), -dot(back, origin), 1];
}

/**
 * Project a pyramid of view, whose half sizes at the distance 1 are given.
 * @param {number} halfWidth @param {number} halfHeight @param {number} near @param {number} far
 * @returns {number[]}
 */
export function perspective(halfWidth, halfHeight, near, far) {
  const depth = near - far;
  return [1 / halfWidth, 0, 0, 0, 0, 1 / halfHeight, 0, 0, 0, 0, (far + near) / depth, -1, 0, 0, (2 * far * near) / depth, 0];
}

/**
 * Project a box of view.
 * @param {number} half its half width and height @param {number} near @param {number} far
 * @returns {number[]}
 */
export function orthographic(half, near, far) {
  const depth = near - far;
  return [1 / half, 0, 0, 0, 0, 1 / half, 0, 0, 0, 0, 2 / depth, 0, 0, 0, (far + near) / depth, 1];
}
