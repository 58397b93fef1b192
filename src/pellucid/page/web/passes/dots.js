// The samples as dots over the picture: bright where they are seen, dark where the body hides them.

import { HEADER } from "./shared.js";

/** @import { Device, Texture, Values } from "../device.js" */

const PLACE = `${HEADER}
uniform sampler2D samplePlaces, seenPlaces;
uniform mat4 matrix;
uniform vec3 eye;
uniform int sampleWidth;
uniform float size;
out vec3 tint;
void main() {
  vec3 p = texelFetch(samplePlaces, ivec2(gl_VertexID % sampleWidth, gl_VertexID / sampleWidth), 0).xyz;
  gl_Position = matrix * vec4(p, 1.);
  gl_PointSize = size;
  ivec2 pixels = textureSize(seenPlaces, 0);
  vec4 seen = texelFetch(seenPlaces, clamp(ivec2((gl_Position.xy / gl_Position.w * .5 + .5) * vec2(pixels)), ivec2(0), pixels - 1), 0);
  bool hidden = seen.w > 0. && length(seen.xyz - eye) < .99 * length(p - eye);
  tint = hidden ? vec3(.27, .2, .35) : vec3(1., .55, .16);
}`;

const DOT = `${HEADER}
in vec3 tint;
out vec4 colour;
void main() {
  if (length(gl_PointCoord - .5) > .5) discard;
  colour = vec4(tint, 1.);
}`;

export class DotsPass {
  /** @param {Device} device */
  constructor(device) {
    this.device = device;
  }

  /** Draw on the canvas. @param {Values} values @param {number} count */
  draw(values, count) {
    const { gl } = this.device;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.bindVertexArray(this.device.vertices);
    this.device.use(this.device.program("dots", DOT, PLACE), { size: 5, ...values });
    gl.drawArrays(gl.POINTS, 0, count);
  }
}
