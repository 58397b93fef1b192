// Stage 3a: what every pixel sees: a place on the body or on the floor, and its normal.

import { HEADER, MESH } from "./shared.js";

/** @import { Device, Texture, Values } from "../device.js" */
/** @import { Body } from "../body.js" */

/** What a pixel sees, in the fourth number of its place. */
export const BODY = 1;
export const FLOOR = 2;

const SURFACE = `${HEADER}
in vec3 p;
in vec3 n;
uniform mat4 matrix;
uniform vec2 jitter, size;
layout(location = 0) out vec4 place;
layout(location = 1) out vec4 normal;
layout(location = 2) out vec4 summed;
#ifdef BY_VERTEX
in vec3 exitance;
#endif

// Rasterisers round the corners of triangles, to 1/16 of a pixel in software: what is interpolated belongs to a place
// beside the middle of the pixel. Where a surface is seen at a grazing angle its Fresnel transmittance shows that.
vec2 beside() {
  vec4 clip = matrix * vec4(p, 1.);
  return clamp(gl_FragCoord.xy - ((clip.xy / clip.w + jitter) * .5 + .5) * size, -1., 1.);
}

void main() {
  vec2 step = beside();
  place = vec4(p + step.x * dFdx(p) + step.y * dFdy(p), ${BODY}.);
  normal = vec4(normalize(n + step.x * dFdx(n) + step.y * dFdy(n)), 0.);
#ifdef BY_VERTEX
  summed = vec4(exitance, 1.);
#else
  summed = vec4(0);
#endif
}`;

const FLOOR_PLACE = `${HEADER}
uniform mat4 matrix;
uniform vec2 jitter;
uniform vec3 centre, across, along;
out vec3 p;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2. - 1.;
  p = centre + corner.x * across + corner.y * along;
  gl_Position = matrix * vec4(p, 1.);
  gl_Position.xy += jitter * gl_Position.w;
}`;

const FLOOR_SURFACE = `${HEADER}
in vec3 p;
uniform vec3 up;
layout(location = 0) out vec4 place;
layout(location = 1) out vec4 normal;
layout(location = 2) out vec4 summed;
void main() { place = vec4(p, ${FLOOR}.); normal = vec4(up, 0.); summed = vec4(0); }`;

/**
 * A floor below the body: its middle, and half its sides.
 * @typedef {{centre: number[], across: number[], along: number[], up: number[]}} Floor
 */

export class SurfacePass {
  /** @param {Device} device @param {Body} body */
  constructor(device, body) {
    this.device = device;
    this.body = body;
    this.count = 0;
    this.size = [0, 0];
  }

  /** @param {number} width @param {number} height */
  allocate(width, height) {
    if (this.size[0] === width && this.size[1] === height) return;
    const { device } = this;
    device.free(this.places, this.normals, this.summed, this.depth);
    if (this.target) device.gl.deleteFramebuffer(this.target);
    this.size = [width, height];
    this.places = device.texture("RGBA32F", width, height);
    this.normals = device.texture("RGBA16F", width, height);
    this.summed = device.texture("RGBA16F", width, height, { levels: 1 + Math.floor(Math.log2(Math.max(width, height))) });
    this.depth = device.texture("DEPTH_COMPONENT24", width, height);
    this.target = device.target([this.places, this.normals, this.summed], this.depth);
  }

  /**
   * @param {number[]} matrix of the camera @param {number[]} jitter of the pixels, in clip space
   * @param {Texture | null} exitanceOf the vertices, where it is known there @param {Floor | null} floor
   */
  draw(matrix, jitter, exitanceOf, floor) {
    const { gl } = this.device;
    this.count++;
    gl.bindFramebuffer(gl.FRAMEBUFFER, /** @type {WebGLFramebuffer} */ (this.target));
    gl.viewport(0, 0, this.size[0], this.size[1]);
    gl.enable(gl.DEPTH_TEST);
    for (let k = 0; k < 3; k++) gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const program = this.device.program("surface", SURFACE, MESH, exitanceOf ? ["BY_VERTEX"] : []);
    /** @type {Values} */
    const values = { matrix, jitter, size: this.size };
    if (exitanceOf) values.exitanceOf = exitanceOf;
    this.body.draw(program, values, gl.BACK);
    if (!floor) return;
    gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(this.device.vertices);
    this.device.use(this.device.program("floor", FLOOR_SURFACE, FLOOR_PLACE), { matrix, jitter, ...floor });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** @returns {Values} what later passes read */
  get values() {
    return { seenPlaces: /** @type {Texture} */ (this.places), seenNormals: /** @type {Texture} */ (this.normals) };
  }
}
