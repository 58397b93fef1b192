// Lamps so near to the body that its texels miss much of their light (light/lamps.py).

import { dot, subtract } from "./vectors.js";

/** @import { Body } from "./body.js" */
/** @import { Lamp } from "./passes/shadow.js" */
/** @import { Vector } from "./vectors.js" */

const CLOSE = 2; // distances between texels

/**
 * Say which lamps are too near.
 * @param {Body} body @param {Lamp[]} lamps @param {number} millimetres of a unit of the scene
 * @returns {string} empty where none is
 */
export function tooNear(body, lamps, millimetres) {
  const { spacing } = body;
  const said = lamps.flatMap(({ kind, position }, k) => {
    const distance = kind === "point" ? distanceFrom(body, position, CLOSE * spacing) : Infinity;
    if (distance === Infinity) return [];
    const [far, apart] = [distance, spacing].map((length) => (length * millimetres).toPrecision(2));
    return [`Lamp ${k + 1} is ${far} mm from the object, whose texels are ${apart} mm apart: much of its light is lost.`];
  });
  return said.join(" ");
}

/**
 * Distance from a place to the nearest texel; infinite beyond a limit.
 * @param {Body} body @param {Vector} p @param {number} limit [scene units]
 */
function distanceFrom({ centre, radius, texels: { places } }, p, limit) {
  const from = subtract(p, centre);
  if (dot(from, from) > (radius + limit) ** 2) return Infinity;
  let nearest = limit ** 2;
  for (let k = 0; k < places.length; k += 4) {
    if (places[k + 3] === 0) continue;
    nearest = Math.min(nearest, (places[k] - p[0]) ** 2 + (places[k + 1] - p[1]) ** 2 + (places[k + 2] - p[2]) ** 2);
  }
  return nearest < limit ** 2 ? Math.sqrt(nearest) : Infinity;
}
