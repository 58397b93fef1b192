// R_d split into a near and a far part, and the places around a point that gather the near one (CLHHC08 section 4).

/** @import { Medium } from "./medium.js" */

export const IMPORTANCE_BOUND = 0.1; // c [1/mm]
export const STEEPNESS = 1.5; // K [1/mm]
const RINGS = 20;
const PER_RING = 20;
const TURN = 0.5 * (3 - Math.sqrt(5)); // of a step, from ring to ring

/** @typedef {{radius: number, steepness: number}} Split  R_p and K, per scene unit; a radius of 0 leaves all light far */

/**
 * Find the largest distance at which R_d(r) 2 pi r falls to the bound, over the channels.
 * @param {Medium} medium @param {number} millimetres that a scene unit has
 * @returns {Split}
 * Source: CLHHC08 section 4.1.
 */
export function decompose(medium, millimetres) {
  const bound = IMPORTANCE_BOUND * millimetres;
  const radii = medium.channels.map((channel) => {
    const importance = (/** @type {number} */ r) => channel.profile(r) * 2 * Math.PI * r;
    const radius = (/** @type {number} */ k) => 10 ** (-3 + (8 * k) / 512) / channel.extinction;
    let k = 512;
    while (k >= 0 && importance(radius(k)) <= bound) k--;
    if (k < 0) return 0;
    let [low, high] = [radius(k), radius(k + 1)];
    for (let step = 0; step < 40; step++) {
      const middle = (low + high) / 2;
      [low, high] = importance(middle) < bound ? [low, middle] : [middle, high];
    }
    return low;
  });
  return { radius: Math.max(...radii), steepness: STEEPNESS * millimetres };
}

/**
 * Weigh the far part: W_g, one less W_l.
 * @param {Split} split @param {number} r
 * Source: CLHHC08 section 4.1.
 */
export function farWeight({ radius, steepness }, r) {
  if (radius === 0) return 1;
  const beyond = (r - radius) * steepness;
  const tail = 0.5 * Math.exp(-Math.abs(beyond));
  return beyond <= 0 ? tail : 1 - tail;
}

/**
 * Spread places around a point by importance sampling of the near part over a plane.
 * @param {Medium} medium @param {Split} split
 * @returns {{places: Float32Array, count: number}} four numbers a place: two offsets, the area it stands for, nothing
 * Source: CLHHC08 section 4.2; radii after MKBVR03.
 */
export function rings(medium, split) {
  const shortest = Math.min(...medium.channels.map((channel) => 1 / channel.extinction));
  const radii = [0, ...Array.from({ length: 1024 }, (_, k) => shortest * 10 ** (-3 + (7 * k) / 1023))];
  const density = radii.map((r) => (1 - farWeight(split, r)) * medium.profile(r).reduce((sum, x) => sum + x));
  const within = [0];
  for (let k = 1; k < radii.length; k++) {
    within.push(within[k - 1] + 0.5 * Math.PI * (density[k] + density[k - 1]) * (radii[k] ** 2 - radii[k - 1] ** 2));
  }
  const total = within[within.length - 1];
  const count = RINGS * PER_RING + 1;
  const places = new Float32Array(4 * count);
  places[2] = total / (count * density[0]);
  for (let k = 1; k < count; k++) {
    const [ring, step] = [Math.floor((k - 1) / PER_RING), (k - 1) % PER_RING];
    const r = interpolated(within, radii, (total * (1 + (ring + 0.5) * PER_RING)) / count);
    const angle = (2 * Math.PI * (step + ((ring * TURN) % 1))) / PER_RING;
    places.set([r * Math.cos(angle), r * Math.sin(angle), total / (count * interpolated(radii, density, r))], 4 * k);
  }
  return { places, count };
}

/**
 * Follow the straight lines between points (xs, ys), xs ascending.
 * @param {number[]} xs @param {number[]} ys @param {number} x
 */
function interpolated(xs, ys, x) {
  let [low, high] = [0, xs.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    [low, high] = xs[middle] <= x ? [middle, high] : [low, middle];
  }
  return ys[low] + ((ys[high] - ys[low]) * (x - xs[low])) / Math.max(xs[high] - xs[low], 1e-300);
}
