// Stage 1c: sums of four, level by level, of light and of surface (CLHHC08 figure 2b).
// Sums of four stay exact where a running sum over a million texels would not.

import { HEADER } from "./shared.js";

/** @import { Device, Texture } from "../device.js" */

const REDUCE = `${HEADER}
uniform sampler2D below;
uniform int level;
out vec4 sums;
void main() {
  ivec2 at = 2 * ivec2(gl_FragCoord.xy);
  sums = texelFetch(below, at, level) + texelFetch(below, at + ivec2(1, 0), level)
       + texelFetch(below, at + ivec2(0, 1), level) + texelFetch(below, at + ivec2(1, 1), level);
}`;

export class PyramidPass {
  /** @param {Device} device @param {Texture} sums mipmapped @param {number} levels */
  constructor(device, sums, levels) {
    this.device = device;
    this.sums = sums;
    this.targets = Array.from({ length: levels }, (_, k) => device.target([sums], null, k + 1));
  }

  draw() {
    const { gl } = this.device;
    const program = this.device.program("pyramid", REDUCE);
    const limit = (/** @type {number} */ level) => {
      gl.bindTexture(gl.TEXTURE_2D, this.sums.handle);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAX_LEVEL, level); // what is written is not to be read
    };
    this.targets.forEach((target, level) => {
      limit(level);
      const size = this.sums.width >> (level + 1);
      this.device.everywhere(target, size, size, program, { below: this.sums, level });
    });
    limit(this.targets.length);
  }
}
