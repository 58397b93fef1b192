// Stage 0: the profile R_d over discs of all sizes, a row each (methods/texture_space/discs.py).
// Columns are log2(1 + r^2 / e^2), e the distance within which R_d is nearly even; the first row is the profile itself, filled in from the medium.
// Where the profile follows the curve there are two parts, one behind the other: R_d, and beta (model/profiles.py, curve_over_disc).

import { farWeight } from "../decomposition.js";
import { HEADER } from "./shared.js";

/** @import { Device, Texture } from "../device.js" */
/** @import { Medium } from "../medium.js" */
/** @import { Split } from "../decomposition.js" */

const WIDTH = 1024;
// Of R_d in a texture of 16 or of 32-bit floats: far above beta in the next row, of which filters may take a trace.
const LARGEST = { 16: 2 ** 14, 32: 2 ** 20 };

const DISC = `${HEADER}
uniform sampler2D profile;
uniform float perSquare, octaves, smallest, even, steepest, rows, parts;
out vec4 mean;
const int INNER = 160, OUTER = 48;
const float NODE[8] = float[](-.9602898565, -.7966664774, -.5255324099, -.1834346425, .1834346425, .5255324099, .7966664774, .9602898565);
const float WEIGHT[8] = float[](.1012285363, .2223810345, .3137066459, .3626837834, .3626837834, .3137066459, .2223810345, .1012285363);

vec3 light = vec3(0), moment = vec3(0);  // sums of R_d, and of beta r R_d

void add(float share, float r2) {
  float column = log2(1. + r2 * perSquare) / octaves * float(${WIDTH - 1});
  if (column > float(${WIDTH - 1})) return;
  vec2 at = vec2((column + .5) / float(${WIDTH}), .5 / parts);
  vec3 value = share * textureLod(profile, at, 0.).rgb;
  light += value;
  if (gl_FragCoord.y > rows) moment += value * sqrt(r2) * textureLod(profile, at + vec2(0, .5), 0.).rgb;
}

// Beside a wide disc the peak of R_d is narrow: rings around the point, each by the light of the disc on it.
// Along a ring the root of that light is a + b cos(angle), up to where the ring leaves the disc.
void byRings(float r, float disc) {
  float first = min(1e-2 * even, 1e-3 * disc), inner = 0.;
  for (int k = 0; k < INNER + OUTER; k++) {
    float outer = k < INNER ? first * pow(disc / first, float(k) / float(INNER - 1)) : disc * pow(3.5, float(k - INNER + 1) / float(OUTER));
    float rho2 = .5 * (outer * outer + inner * inner);
    float a = 1. - (r * r + rho2) / (disc * disc), b = 2. * r * sqrt(rho2) / (disc * disc);
    float cosine = clamp(-a / max(b, 1e-30), -1., 1.), angle = acos(cosine), sine = sqrt(1. - cosine * cosine);
    float onRing = a * a * angle + 2. * a * b * sine + .5 * b * b * (angle + sine * cosine);
    add(3. / (PI * disc * disc) * onRing * (outer * outer - inner * inner), rho2);
    inner = outer;
  }
}

// Gauss-Legendre in the squared radius, where area is even, midpoints over half a turn.
void byNodes(float r, float disc) {
  for (int i = 0; i < 8; i++) {
    float rho = disc * sqrt((NODE[i] + 1.) * .5), share = .75 * (1. - NODE[i]) * (1. - NODE[i]) * WEIGHT[i] / 24.;
    for (int k = 0; k < 12; k++) add(share, max(r * r + rho * rho - 2. * r * rho * cos((float(k) + .5) * PI / 12.), 0.));
  }
}

void main() {
  float r = sqrt(max(exp2((gl_FragCoord.x - .5) / float(${WIDTH - 1}) * octaves) - 1., 0.) / perSquare);
  float row = mod(floor(gl_FragCoord.y), rows), disc = smallest * exp2(.5 * (row - 1.));
  if (row < 1.) add(1., r * r);
  else if (r < 2.5 * disc && disc > 3. * even) byRings(r, disc);
  else byNodes(r, disc);
  // On a sphere mu grows with the distance r: beta of a disc is the mean of beta r R_d over r times that of R_d.
  mean = vec4(gl_FragCoord.y > rows ? clamp(moment / max(light * r, 1e-35), 0., steepest) : light, 1.);
}`;

/**
 * A profile on the device.
 * @typedef {object} ProfileRows
 * @property {Texture} texture
 * @property {number} rows of each part
 * @property {number} smallest radius of the second row [scene units]
 * @property {number} perSquare @property {number} slope @property {number} start  from r^2 to columns
 * @property {number} unscale  from entries to R_d
 */

export class ProfilePass {
  /** @param {Device} device */
  constructor(device) {
    this.device = device;
    this.count = 0;
  }

  /**
   * Tabulate a part of a profile over discs up to a radius.
   * @param {Medium} medium @param {number} extent of the body [scene units]
   * @param {{even: number, smallest: number, largest: number, sizes: number, steepest: number}} discs distance within which R_d is even
   *   and radius of the smallest [shortest mean free paths], and of the largest [scene units]; how many; the largest beta
   * @param {(r: number) => number} weight by which R_d is multiplied
   * @returns {ProfileRows}
   */
  make(medium, extent, discs, weight) {
    const { device } = this;
    const { gl } = device;
    this.count++;
    const even = discs.even * medium.shortest;
    const perSquare = 1 / even ** 2;
    const octaves = Math.log2(1 + 3 * extent ** 2 * perSquare) + 0.1;
    const values = new Float32Array(4 * WIDTH);
    const curve = new Float32Array(4 * WIDTH);
    for (let k = 0; k < WIDTH; k++) {
      const r = Math.sqrt((2 ** ((k / (WIDTH - 1)) * octaves) - 1) / perSquare);
      const share = weight(r);
      values.set(
        medium.profile(r).map((value) => value * share),
        4 * k,
      );
      curve.set(medium.curve(r), 4 * k);
    }
    const parts = medium.isCurved ? 2 : 1;
    const scale = LARGEST[device.filtersFloats ? 32 : 16] / values.reduce((most, value) => Math.max(most, value), 1e-30);
    const base = this.texture(parts);
    [values.map((value) => value * scale), curve].slice(0, parts).forEach((part, row) => {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, WIDTH, 1, gl.RGBA, gl.FLOAT, part);
    });
    const smallest = discs.smallest * medium.shortest;
    const steps = discs.largest < smallest ? 0 : 1 + Math.ceil(2 * Math.log2(discs.largest / smallest));
    const rows = 1 + Math.min(steps, discs.sizes);
    const texture = rows === 1 ? base : this.texture(rows * parts);
    if (rows > 1) {
      const target = device.target([texture]);
      const program = device.program("profile", DISC);
      const values = { profile: base, perSquare, octaves, smallest, even, steepest: discs.steepest, rows, parts };
      device.everywhere(target, WIDTH, rows * parts, program, values);
      gl.deleteFramebuffer(target);
      device.free(base);
    }
    return { texture, rows, smallest, perSquare, slope: (WIDTH - 1) / WIDTH / octaves, start: 0.5 / WIDTH, unscale: 1 / scale };
  }

  /** @param {number} rows */
  texture(rows) {
    return this.device.texture(this.device.filtersFloats ? "RGBA32F" : "RGBA16F", WIDTH, rows, { linear: true });
  }
}

/** @type {(split: Split) => (r: number) => number} */
export const far = (split) => (r) => farWeight(split, r);
/** @type {(split: Split) => (r: number) => number} */
export const near = (split) => (r) => 1 - farWeight(split, r);
