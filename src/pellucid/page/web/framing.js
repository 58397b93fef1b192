// Where the camera stands, as matrices, and the floor below the body.

import { add, cross, dot, perspective, product, subtract, times, unit, viewMatrix } from "./vectors.js";

/** @import { Body } from "./body.js" */
/** @import { Floor } from "./passes/surface.js" */
/** @import { Vector } from "./vectors.js" */

/**
 * @typedef {object} Camera
 * @property {Vector} origin @property {Vector} target @property {Vector} up
 * @property {number} fov vertical angle of view [degrees]
 */

/** @param {Body} body @param {Vector} up @param {number} radii from its middle to its border @returns {Floor} */
export function floorBelow(body, up, radii) {
  const { positions } = body.mesh;
  let lowest = Infinity;
  for (let k = 0; k < positions.length; k += 3)
    lowest = Math.min(lowest, dot([positions[k], positions[k + 1], positions[k + 2]], up));
  const across = unit(cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
  const reach = radii * body.radius;
  const centre = add(body.centre, times(up, lowest - dot(body.centre, up)));
  return { centre, across: times(across, reach), along: times(cross(up, across), reach), up };
}

/** @param {Camera} camera @param {number} width @param {number} height @param {Body} body */
export function viewOf(camera, width, height, body) {
  const forward = unit(subtract(camera.target, camera.origin));
  const right = unit(cross(forward, camera.up));
  const up = cross(right, forward);
  const halfHeight = Math.tan((camera.fov * Math.PI) / 360);
  const halfWidth = (halfHeight * width) / height;
  const distance = Math.hypot(...subtract(camera.origin, body.centre));
  const far = distance + 9 * body.radius; // the floor, too
  const near = Math.max(distance - 9 * body.radius, 1e-2 * body.radius);
  const projection = perspective(halfWidth, halfHeight, near, far);
  const matrix = product(projection, viewMatrix({ right, up, back: times(forward, -1) }, camera.origin));
  return { forward, right, up, halfWidth, halfHeight, matrix, pixel: (2 * halfHeight) / height };
}
