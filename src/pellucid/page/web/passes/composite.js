// Stage 3c: from exitance to the screen: Fresnel, tone mapping, highlights; floor and background (CLHHC08 eq. 11, section 3).

import { GATHER } from "./gather.js";
import { HEADER, LAMPS } from "./shared.js";
import { FLOOR } from "./surface.js";

/** @import { Device, Texture, Values } from "../device.js" */

/** How bright the mean of what is seen becomes: so many times one half, before the curve. */
export const AUTOMATIC = 1.1;

const COMPOSITE = `${HEADER}${LAMPS}${GATHER}
uniform sampler2D seenPlaces, seenNormals, exitances, sums;
uniform int stride, levels, topLevel, autoExposure;
uniform vec3 eye, background, floorColour;
uniform vec2 pixelSize;                    // of a pixel at the distance 1, and the radius of the body
uniform float eta, leave, area, stops, highlight, shininess;
uniform vec3 skyRadiance[9];               // spherical harmonics
uniform vec3 forward, rightward, upward;   // of the view; rightward and upward reach its border
uniform int hasSky;
out vec4 colour;

vec3 skyTowards(vec3 d) {
  vec3 sum = skyRadiance[0] * .282095 + .488603 * (skyRadiance[1] * d.y + skyRadiance[2] * d.z + skyRadiance[3] * d.x)
    + 1.092548 * (skyRadiance[4] * d.x * d.y + skyRadiance[5] * d.y * d.z + skyRadiance[7] * d.x * d.z)
    + .315392 * skyRadiance[6] * (3. * d.z * d.z - 1.) + .546274 * skyRadiance[8] * (d.x * d.x - d.y * d.y);
  return max(sum, vec3(0));
}

vec3 toneMapped(vec3 radiance, float scale) { vec3 scaled = radiance * scale; return scaled / (1. + scaled); }

// Between those of the coarse sums around a pixel that lie in its plane; where none does, a sum of its own.
vec3 interpolated(ivec2 at, vec3 x, vec3 n, vec3 outward) {
  vec2 f = (vec2(at) - float(stride / 2)) / float(stride);
  ivec2 first = ivec2(floor(f));
  f -= floor(f);
  vec4 all = vec4(0);
  float reach = pixelSize.x * float(stride) * length(x - eye);
  for (int k = 0; k < 4; k++) {
    ivec2 corner = ivec2(k & 1, k >> 1), cell = clamp(first + corner, ivec2(0), textureSize(exitances, 0) - 1);
    vec4 value = texelFetch(exitances, cell, 0);
    if (value.w == 0.) continue;
    vec3 d = texelFetch(seenPlaces, min(cell * stride + stride / 2, textureSize(seenPlaces, 0) - 1), 0).xyz - x;
    if (abs(dot(d, n)) > .7 * reach || dot(d, d) > 16. * reach * reach) continue;
    vec2 weight = mix(1. - f, f, vec2(corner));
    all += vec4(value.rgb, 1.) * (weight.x * weight.y + 1e-4);
  }
  return all.w > .2 ? all.rgb / all.w : exitanceAt(x, outward);
}

// The radiance that tone mapping shows as one half: of a white surface in the average light, or of what the picture shows.
float halfWhite() {
  vec4 mean = texelFetch(exitances, ivec2(0), topLevel);
  float flux = texelFetch(sums, ivec2(0), levels).x;
  if (autoExposure == 1 && mean.a > 1e-4) return max(luminance(mean.rgb) / mean.a / PI / float(${AUTOMATIC}), 1e-20);
  return flux > 0. ? flux / (PI * area) : 1.;
}

void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 place = texelFetch(seenPlaces, at, 0);
  vec2 screen = 2. * gl_FragCoord.xy / vec2(textureSize(seenPlaces, 0)) - 1.;
  vec3 view = normalize(forward + screen.x * rightward + screen.y * upward);
  float scale = exp2(stops) / halfWhite();
  vec3 behind = hasSky == 1 ? toneMapped(skyTowards(view), scale) : background;
  if (place.w == 0.) { colour = vec4(behind, 1.); return; }
  vec3 outward = texelFetch(seenNormals, at, 0).xyz, n = outward, x = place.xyz, result;
  view = normalize(x - eye);
  float cosine = -dot(n, view);
  if (cosine < 0.) { n = -n; cosine = -cosine; }
  if (place.w == ${FLOOR}.) {
    vec3 falling = vec3(0);
    for (int k = 0; k < MOST_LAMPS; k++) {
      if (k >= lampCount) break;
      float fall;
      float c = max(dot(n, toLamp(lamps[k], x, fall)), 0.);
      falling += spectra[k] * (c * fall * seen(k, x));
    }
    // Under the body there is less sky: as beside a ball of its size that stands there.
    vec3 towards = mapCentre - x;
    float covered = pixelSize.y / max(length(towards), pixelSize.y), aside = max(dot(normalize(towards), n), 0.);
    if (hasSky == 1) falling += PI * skyTowards(n) * .8 * (1. - covered * covered * aside);
    float away = length(towards) / pixelSize.y;
    colour = vec4(mix(toneMapped(floorColour * falling / PI, scale), behind, smoothstep(2.5, 6., away)), 1.);
    return;
  }
  vec3 exitance = stride == 1 ? texelFetch(exitances, at, 0).rgb : interpolated(at, x, n, outward);
  result = toneMapped(exitance * (transmitted(cosine, eta) * leave), scale);
  vec3 mirrored = reflect(view, n);
  for (int k = 0; k < MOST_LAMPS; k++) {
    if (k >= lampCount) break;
    float fall;
    vec3 d = toLamp(lamps[k], x, fall);
    float lobe = highlight * pow(max(dot(mirrored, d), 0.), shininess);
    if (lobe > 1. / 256. && dot(n, d) > 0.) result += toneMapped(spectra[k] * (fall / PI), scale) * lobe * seen(k, x + n * bias * 2.);
  }
  if (hasSky == 1) result += toneMapped(skyTowards(mirrored), scale) * highlight * (.04 + .96 * pow(1. - cosine, 5.));
  colour = vec4(result, 1.);
}`;

const PRESENT = `${HEADER}
uniform sampler2D picture;
out vec4 colour;
void main() { colour = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.); }`;

export class CompositePass {
  /** @param {Device} device @param {string[]} kind of the sums */
  constructor(device, kind) {
    this.device = device;
    this.kind = kind;
    this.size = [0, 0];
  }

  /** @param {number} width @param {number} height */
  allocate(width, height) {
    if (this.size[0] === width && this.size[1] === height) return;
    this.device.free(this.picture);
    if (this.target) this.device.gl.deleteFramebuffer(this.target);
    this.size = [width, height];
    this.picture = this.device.texture("RGBA16F", width, height);
    this.target = this.device.target([this.picture]);
  }

  /** @param {Values} values @param {number} pass pictures before this one, with which it is averaged */
  draw(values, pass) {
    const { gl } = this.device;
    const [width, height] = this.size;
    if (pass > 0) {
      gl.enable(gl.BLEND);
      gl.blendColor(0, 0, 0, 1 / (pass + 1));
      gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    }
    const target = /** @type {WebGLFramebuffer} */ (this.target);
    this.device.everywhere(target, width, height, this.device.program("composite", COMPOSITE, undefined, this.kind), values);
    gl.disable(gl.BLEND);
  }

  /** Show the picture on the canvas. */
  present() {
    const picture = /** @type {Texture} */ (this.picture);
    this.device.everywhere(null, this.size[0], this.size[1], this.device.program("present", PRESENT), { picture });
  }
}
