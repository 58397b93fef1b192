// Hybrid, 1: translucent shadow maps, the light that enters the body as each lamp sees it (CLHHC08 section 4.2;
// methods/texture_space/shadow_map.py). A pixel holds the power that enters there, and the plane where it does: a flattened
// depth behind the centre, which is even along planes as that of a depth buffer, and its slopes.

import { COLOUR, HEADER, MESH } from "./shared.js";

/** @import { Device, Texture, Values } from "../device.js" */
/** @import { Body } from "../body.js" */
/** @import { LampView } from "./shadow.js" */

const STEEPEST = "64."; // change of depth over the distance across the light by which the surface within a pixel is followed

const ENTERING = `${HEADER}${COLOUR}
in vec3 p;
in vec3 n;
in vec2 uv;
uniform vec4 lamp;
uniform vec3 spectrum, axis, centre;
uniform float eta, lampDistance, zoom;
layout(location = 0) out vec4 entering;
layout(location = 1) out vec2 slopes;

void main() {
  vec3 way = lamp.w > 0. ? p - lamp.xyz : axis;
  float far = length(way);
  vec3 d = way / far, facetNormal = normalize(cross(dFdx(p), dFdy(p)));
  // The facet passes what the smooth surface that it stands for would, as far as the light sees it.
  float facet = abs(dot(d, facetNormal));
  float smoothed = -dot(d, normalize(n)) * (gl_FrontFacing ? 1. : -1.);
  float excess = clamp(smoothed / max(facet, 1e-6), 0., 4.);
  // Area of the pixel, or its solid angle: of a square in a plane at the distance d, dA cos^3 / d^2.
  float extent = 1. / (zoom * zoom);
  if (lamp.w > 0.) {
    float beyond = far / dot(way, axis);
    extent /= beyond * beyond * beyond;
    extent /= lampDistance * lampDistance;
  }
  ivec2 texel = ivec2(uv * vec2(textureSize(colourMap, 0)));
  float depth = dot(p - centre, axis), flattened = lamp.w > 0. ? depth / (1. + depth / lampDistance) : depth;
  entering = vec4(spectrum * colourAt(texel) * (extent * excess * transmitted(smoothed, eta)), flattened);
  slopes = clamp(vec2(dFdx(flattened), dFdy(flattened)) * zoom, -${STEEPEST}, ${STEEPEST});
}`;

export class NearMapPass {
  /** @param {Device} device @param {Body} body @param {number} size of each map */
  constructor(device, body, size) {
    this.device = device;
    this.body = body;
    this.size = size;
    this.count = 0;
    /** @type {Texture | null} */
    this.maps = null;
    /** @type {Texture | null} */
    this.slopes = null;
    this.depth = device.texture("DEPTH_COMPONENT24", size, size);
  }

  /** @param {number} lamps for which there is to be room */
  allocate(lamps) {
    if (this.maps?.layers === lamps) return false;
    this.device.free(this.maps, this.slopes);
    this.maps = this.device.texture("RGBA32F", this.size, this.size, { layers: lamps });
    this.slopes = this.device.texture("RG16F", this.size, this.size, { layers: lamps });
    return true;
  }

  /** @param {LampView} view */
  zoom({ half }) {
    return (0.5 * this.size) / half;
  }

  /** @param {number} k which lamp @param {LampView} view @param {Values} values */
  draw(k, view, values) {
    const { gl } = this.device;
    this.count++;
    const target = this.device.target(/** @type {Texture[]} */ ([this.maps, this.slopes]), this.depth, k);
    gl.viewport(0, 0, this.size, this.size);
    gl.enable(gl.DEPTH_TEST);
    for (let place = 0; place < 2; place++) gl.clearBufferfv(gl.COLOR, place, [0, 0, 0, 0]);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    const { axis, distance, matrix } = view;
    const program = this.device.program("near map", ENTERING, MESH);
    const { centre } = this.body;
    const more = { matrix, jitter: [0, 0], axis, centre, lampDistance: distance, zoom: this.zoom(view) };
    this.body.draw(program, { ...values, ...more, ...this.body.maps }, gl.BACK);
    gl.deleteFramebuffer(target);
  }
}
