// Stage 1a: what each lamp sees, as depths. Of a closed body its back faces: no facet shadows itself.

import { HEADER, MESH } from "./shared.js";
import * as vectors from "../vectors.js";

/** @import { Device, Texture } from "../device.js" */
/** @import { Body } from "../body.js" */
/** @import { Vector } from "../vectors.js" */

const DEPTH = `${HEADER}
void main() {}`;

const MARGIN = 1.001; // around the ball of the body
const WIDEST = 0.97; // sine of half the widest angle of view, of a lamp near or in the body

/**
 * A lamp of the scene.
 * @typedef {object} Lamp
 * @property {"point" | "directional"} kind
 * @property {Vector} position of a point; for a directional lamp the direction to it
 * @property {Vector} colour linear, the largest is 1
 * @property {number} intensity W/sr, or W/m^2
 */

/**
 * The camera of a lamp: it looks at the ball around the body.
 * @typedef {object} LampView
 * @property {Vector} right @property {Vector} up @property {Vector} axis
 * @property {number} distance @property {boolean} parallel
 * @property {number} half half the width of the picture, at the distance of the centre
 * @property {number[]} matrix
 * @property {boolean} whole whether the ball is seen as a whole
 */

/**
 * Look at a ball from a lamp (methods/texture_space/shadow_map.py, look).
 * @param {Lamp} lamp @param {Vector} centre @param {number} ball its radius
 * @returns {LampView}
 */
export function lampView(lamp, centre, ball) {
  const radius = MARGIN * ball;
  const parallel = lamp.kind === "directional";
  const from = parallel ? lamp.position : vectors.subtract(lamp.position, centre);
  const distance = parallel ? 4 * radius : Math.max(Math.hypot(...from), 1e-6 * radius);
  const back = vectors.unit(from);
  const axis = vectors.times(back, -1);
  const right = vectors.unit(vectors.cross(Math.abs(axis[1]) < 0.999 ? [0, 1, 0] : [1, 0, 0], axis));
  const up = vectors.cross(right, axis);
  const sine = Math.min(radius / distance, WIDEST);
  const half = parallel ? radius : (distance * sine) / Math.sqrt(1 - sine * sine);
  const [near, far] = [Math.max(distance - radius, 0.02 * radius), distance + radius];
  const projection = parallel
    ? vectors.orthographic(radius, near, far)
    : vectors.perspective(half / distance, half / distance, near, far);
  const eye = vectors.add(centre, vectors.times(back, distance));
  const matrix = vectors.product(projection, vectors.viewMatrix({ right, up, back }, eye));
  return { right, up, axis, distance, parallel, half, matrix, whole: parallel || radius <= 0.9 * distance };
}

export class ShadowPass {
  /** @param {Device} device @param {Body} body @param {number} size of each map [texels] */
  constructor(device, body, size) {
    this.device = device;
    this.body = body;
    this.size = size;
    this.count = 0;
    /** @type {Texture | null} */
    this.maps = null;
    /** @type {WebGLFramebuffer[]} */
    this.targets = [];
  }

  /** @param {number} lamps for which there is to be room */
  allocate(lamps) {
    if (this.maps?.layers === lamps) return false;
    this.targets.forEach((target) => this.device.gl.deleteFramebuffer(target));
    this.device.free(this.maps);
    const maps = this.device.texture("DEPTH_COMPONENT24", this.size, this.size, { layers: lamps, linear: true, compare: true });
    this.targets = Array.from({ length: lamps }, (_, k) => this.device.target([], maps, k));
    this.maps = maps;
    return true;
  }

  /** @param {number} k which lamp @param {LampView} view */
  draw(k, view) {
    const { gl } = this.device;
    this.count++;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[k]);
    gl.viewport(0, 0, this.size, this.size);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    this.body.draw(this.device.program("shadow", DEPTH, MESH), { matrix: view.matrix, jitter: [0, 0] }, gl.FRONT);
  }
}
