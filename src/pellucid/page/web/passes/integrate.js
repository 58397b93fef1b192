// Stage 3b: the exitance at every pixel, at one of 4 or of 16, or at the vertices of the mesh.

import { GATHER } from "./gather.js";
import { HEADER } from "./shared.js";
import { BODY } from "./surface.js";

/** @import { Device, Texture, Values } from "../device.js" */

const INTEGRATE = `${HEADER}${GATHER}
uniform sampler2D seenPlaces, seenNormals;
uniform int stride;
out vec4 exitance;
void main() {
  ivec2 at = min(ivec2(gl_FragCoord.xy) * stride + stride / 2, textureSize(seenPlaces, 0) - 1);
  vec4 place = texelFetch(seenPlaces, at, 0);
  exitance = place.w == ${BODY}. ? vec4(exitanceAt(place.xyz, texelFetch(seenNormals, at, 0).xyz), 1.) : vec4(0);
}`;

export class IntegratePass {
  /** @param {Device} device @param {string[]} kind of the sums */
  constructor(device, kind) {
    this.device = device;
    this.kind = kind;
    this.count = 0;
    /** Pixels at which sums were made, those that see nothing included. */
    this.points = 0;
    this.key = "";
  }

  /**
   * @param {number} width @param {number} height of what is seen @param {number} stride between two sums
   * @param {"RGBA16F" | "RGBA32F"} format
   */
  allocate(width, height, stride, format = "RGBA16F") {
    const key = `${width} ${height} ${stride}`;
    if (key === this.key) return;
    const { device } = this;
    device.free(this.exitance);
    if (this.target) device.gl.deleteFramebuffer(this.target);
    this.key = key;
    this.size = [Math.ceil(width / stride), Math.ceil(height / stride)];
    const levels = format === "RGBA16F" ? 1 + Math.floor(Math.log2(Math.max(...this.size))) : 1;
    this.exitance = device.texture(format, this.size[0], this.size[1], { levels });
    this.target = device.target([this.exitance]);
  }

  /**
   * Sum in some of the rows: a long draw would be taken for a hung driver.
   * @param {Values} values @param {number} stride @param {number} first @param {number} end
   */
  draw(values, stride, first, end) {
    const { gl } = this.device;
    const [width, height] = /** @type {number[]} */ (this.size);
    this.count++;
    this.points += width * (Math.min(end, height) - first);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, first, width, Math.min(end, height) - first);
    const program = this.device.program("integrate", INTEGRATE, undefined, this.kind);
    this.device.everywhere(/** @type {WebGLFramebuffer} */ (this.target), width, height, program, { ...values, stride });
    gl.disable(gl.SCISSOR_TEST);
  }
}
