// Stage 2: N surface samples in proportion to E', by descent through the pyramid with two numbers (CLHHC08 eqs. 9 and 10;
// methods/texture_space/pyramid.py, warp_points, and discs.py).

import { COLOUR, HEADER } from "./shared.js";

/** @import { Device, Values } from "../device.js" */
/** @import { Body } from "../body.js" */

const WIDTH = 64; // of the textures that hold the samples

const SAMPLE = `${HEADER}${COLOUR}
uniform sampler2D sums, power, places, sky;
uniform int levels, count, skyApart;
uniform vec2 shift;
uniform vec2 smallest, rows;  // of the profiles for lamps, and for the sky
uniform vec2 shrink;          // of the discs: 0 lets light enter at points
uniform float overlap;
layout(location = 0) out vec4 place;
layout(location = 1) out vec4 light;
layout(location = 2) out vec4 skyLight;
const float BELOW_ONE = 1. - exp2(-24.);

// Choose one of two values with u, and stretch u to the part that it fell in.
bool halve(float first, float second, inout float u) {
  float share = first / max(first + second, 1e-30);
  bool isSecond = u >= share && second > 0.;
  u = clamp(isSecond ? (u - share) / (1. - share) : u / share, 0., BELOW_ONE);
  return isSecond;
}

// Mirror the bits of a number behind the point (van der Corput).
float radicalInverse(uint x) {
  x = ((x & 0x55555555u) << 1) | ((x >> 1) & 0x55555555u);
  x = ((x & 0x33333333u) << 2) | ((x >> 2) & 0x33333333u);
  x = ((x & 0x0F0F0F0Fu) << 4) | ((x >> 4) & 0x0F0F0F0Fu);
  x = ((x & 0x00FF00FFu) << 8) | ((x >> 8) & 0x00FF00FFu);
  return float((x << 16) | (x >> 16)) * exp2(-32.);
}

void main() {
  int index = int(gl_FragCoord.y) * ${WIDTH} + int(gl_FragCoord.x);
  place = light = skyLight = vec4(0);
  if (index >= count) return;
  float u = min((float(index) + shift.x) / float(count), BELOW_ONE);
  float v = min(fract(radicalInverse(uint(index)) + shift.y), BELOW_ONE);
  vec2 here = texelFetch(sums, ivec2(0), levels).xy;  // light and surface of a cell
  float share = here.x / float(count), surface = 0.;
  ivec2 texel = ivec2(0);
  for (int level = levels - 1; level >= 0; level--) {
    // A sample stands for as much surface as has its share of light, in the smallest cell that has as much.
    if (level == levels - 1 || here.x >= share) surface = share * here.y / max(here.x, 1e-30);
    texel *= 2;
    vec2 a = texelFetch(sums, texel, level).xy, b = texelFetch(sums, texel + ivec2(1, 0), level).xy;
    vec2 c = texelFetch(sums, texel + ivec2(0, 1), level).xy, d = texelFetch(sums, texel + ivec2(1, 1), level).xy;
    bool low = halve(a.x + b.x, c.x + d.x, v);
    vec2 left = low ? c : a, right = low ? d : b;
    bool east = halve(left.x, right.x, u);
    here = east ? right : left;
    texel += ivec2(east, low);
  }
  if (here.x <= 0.) return;
  vec4 at = texelFetch(places, texel, 0);
  vec2 radius = overlap * sqrt(surface / PI) * shrink;
  vec2 row = clamp(floor(log2(max(radius, 1e-20) / smallest) * 2. + 1.5), vec2(0), rows - 1.);
  row = (row + .5) / rows;
  place = vec4(at.xyz, row.x);
  light = vec4(texelFetch(power, texel, 0).rgb * (share / here.x), row.y);
  vec3 ofSky = texelFetch(sky, texel, 0).rgb * colourAt(texel) * (at.w * share / here.x);
  if (skyApart == 1) skyLight = vec4(ofSky, 1.);
  else light.rgb += ofSky;
}`;

export class SamplePass {
  /** @param {Device} device @param {Body} body */
  constructor(device, body) {
    this.device = device;
    this.body = body;
    this.count = 0;
    this.rows = 0;
    /** Places, light of lamps, light of the sky. @type {import("../device.js").Texture[]} */
    this.textures = [];
  }

  /** @param {number} samples N */
  allocate(samples) {
    const rows = Math.ceil(samples / WIDTH);
    if (rows === this.rows) return;
    const { device } = this;
    device.free(...this.textures);
    if (this.target) device.gl.deleteFramebuffer(this.target);
    this.rows = rows;
    this.textures = [0, 1, 2].map(() => device.texture("RGBA32F", WIDTH, rows));
    this.target = device.target(this.textures);
  }

  /** @param {number} samples N @param {Values} values */
  draw(samples, values) {
    this.count++;
    this.allocate(samples);
    const program = this.device.program("samples", SAMPLE);
    const target = /** @type {WebGLFramebuffer} */ (this.target);
    this.device.everywhere(target, WIDTH, this.rows, program, { ...values, places: this.body.maps.places, count: samples });
  }

  /** @returns {Values} what the sums read */
  get values() {
    const [samplePlaces, sampleLights, skyLights] = this.textures;
    return { samplePlaces, sampleLights, skyLights, sampleWidth: WIDTH };
  }
}
