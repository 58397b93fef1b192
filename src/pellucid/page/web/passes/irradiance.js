// Stage 1b: the irradiance image E', the light that enters through each texel of the atlas (CLHHC08 eqs. 6 and 7).

import { COLOUR, HEADER, LAMPS } from "./shared.js";

/** @import { Device, Values } from "../device.js" */
/** @import { Body } from "../body.js" */

const IRRADIANCE = `${HEADER}${LAMPS}${COLOUR}
uniform sampler2D places, starts, directions, sky;
uniform float eta;
layout(location = 0) out vec4 power;
layout(location = 1) out vec4 sums;

void main() {
  ivec2 texel = ivec2(gl_FragCoord.xy);
  float area = texelFetch(places, texel, 0).w;
  power = vec4(0);
  sums = vec4(0);
  if (area == 0.) return;
  vec3 start = texelFetch(starts, texel, 0).xyz, n = texelFetch(directions, texel, 0).xyz;
  for (int k = 0; k < MOST_LAMPS; k++) {
    if (k >= lampCount) break;
    float fall;
    float cosine = dot(n, toLamp(lamps[k], start, fall));
    if (cosine > 0.) power.rgb += spectra[k] * (cosine * fall * transmitted(cosine, eta) * seen(k, start + n * bias));
  }
  vec3 colour = colourAt(texel) * area;
  power.rgb *= colour;
  sums = vec4(luminance(power.rgb + texelFetch(sky, texel, 0).rgb * colour), area, 0, 0);
}`;

export class IrradiancePass {
  /** @param {Device} device @param {Body} body */
  constructor(device, body) {
    const { resolution } = body;
    this.device = device;
    this.body = body;
    this.count = 0;
    this.levels = Math.log2(resolution);
    this.power = device.texture("RGBA32F", resolution, resolution);
    this.sums = device.texture("RG32F", resolution, resolution, { levels: this.levels + 1 });
    this.target = device.target([this.power, this.sums]);
  }

  /** @param {Values} values of the lamps and the medium */
  draw(values) {
    this.count++;
    const { resolution } = this.body;
    const program = this.device.program("irradiance", IRRADIANCE);
    this.device.everywhere(this.target, resolution, resolution, program, {
      ...values,
      ...this.body.maps,
    });
  }
}
