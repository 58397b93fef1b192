// The sums: B(x) over N samples (CLHHC08 eq. 10), and over the places of a filter around x (section 4.2). For shaders.
// With CURVED the surface is not flat: R_d exp(beta mu), mu the cosine between the normal at x and the way to x from where light
// enters (model/profiles.py, curved).

/** @import { MediumTable } from "../medium.js" */

/**
 * What shaders with these sums are to be compiled with.
 * @param {MediumTable} table
 */
export const kindOf = ({ curve }) => (curve ? ["CURVED"] : []);

export const GATHER = `
uniform sampler2D samplePlaces, sampleLights, skyLights;
uniform int sampleCount, sampleWidth;
uniform sampler2D profile, skyProfile, nearProfile;
uniform vec4 toColumn, skyToColumn, nearToColumn;  // 1 / e^2, e where R_d is nearly even, columns an octave, the first column, R_d over entries
uniform int skyApart;
#ifdef CURVED
uniform float mostMu;  // over the distance: beyond, as beside edges, mu is not believed
#endif

vec3 looked(sampler2D rows, vec4 scale, float row, vec3 d, vec3 n) {
  float r2 = dot(d, d), column = log2(r2 * scale.x + 1.) * scale.y + scale.z;
#ifdef CURVED
  float inverse = inversesqrt(max(r2, 1e-20)), most = min(mostMu * r2 * inverse, 1.);
  vec3 beta = textureLod(rows, vec2(column, .5 * row + .5), 0.).rgb;
  return textureLod(rows, vec2(column, .5 * row), 0.).rgb * exp(beta * clamp(dot(n, d) * inverse, -most, most));
#else
  return textureLod(rows, vec2(column, row), 0.).rgb;
#endif
}

vec3 gatherSamples(vec3 x, vec3 n) {
  vec3 sum = vec3(0), ofSky = vec3(0);
  int rest = sampleCount;
  for (int row = 0; rest > 0; row++) {
    for (int k = 0; k < min(sampleWidth, rest); k++) {
      vec4 place = texelFetch(samplePlaces, ivec2(k, row), 0);
      vec4 light = texelFetch(sampleLights, ivec2(k, row), 0);
      vec3 d = x - place.xyz;
      sum += light.rgb * looked(profile, toColumn, place.w, d, n);
      if (skyApart == 1) ofSky += texelFetch(skyLights, ivec2(k, row), 0).rgb * looked(skyProfile, skyToColumn, light.w, d, n);
    }
    rest -= sampleWidth;
  }
  return sum * toColumn.w + ofSky * skyToColumn.w;
}

uniform sampler2DArray nearMaps, nearSlopes;
uniform sampler2D ringPlaces;
uniform vec2 ringTurn;  // cosine and sine of an angle by which the places are turned
uniform int ringCount, mapCount;
uniform vec3 mapRight[MOST_LAMPS], mapUp[MOST_LAMPS], mapAxis[MOST_LAMPS], mapCentre;
uniform vec2 mapScale[MOST_LAMPS];  // pixels a scene unit at the depth of the centre, one over the distance of the lamp

vec3 gatherNear(vec3 x, vec3 n, int map) {
  mat3 turn = transpose(mat3(mapRight[map], mapUp[map], mapAxis[map]));
  vec3 here = turn * (x - mapCentre), facing = turn * n, sum = vec3(0);
  ivec2 size = textureSize(nearMaps, 0).xy;
  float zoom = mapScale[map].x, inverse = mapScale[map].y, scale = zoom / max(here.z * inverse + 1., 1e-6), middle = .5 * float(size.x);
  vec2 at = here.xy * scale + middle;
  for (int k = 0; k < ringCount; k++) {
    vec3 place = texelFetch(ringPlaces, ivec2(k, 0), 0).xyz;
    vec2 aside = mat2(ringTurn.x, ringTurn.y, -ringTurn.y, ringTurn.x) * place.xy;
    vec2 there = at + aside * scale;
    ivec2 pixel = ivec2(floor(there));
    if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, size))) continue;
    vec4 entering = texelFetch(nearMaps, ivec3(pixel, map), 0);
    // Light enters at the place itself, in the plane of its pixel, the middle of which may be far nearer to x.
    vec2 slope = texelFetch(nearSlopes, ivec3(pixel, map), 0).xy;
    float flattened = entering.w + dot(slope, there - vec2(pixel) - .5) / zoom;
    vec3 d = here - vec3((there - middle) / zoom, flattened) / (1. - flattened * inverse);
    sum += entering.rgb * place.z * looked(nearProfile, nearToColumn, .5, d, facing);
  }
  return sum * (scale * scale * nearToColumn.w);  // from power a pixel to power an area
}

vec3 exitanceAt(vec3 x, vec3 n) {
  vec3 sum = gatherSamples(x, n);
  for (int map = 0; map < MOST_LAMPS; map++) {
    if (map >= mapCount) break;
    sum += gatherNear(x, n, map);
  }
  return sum;
}
`;
