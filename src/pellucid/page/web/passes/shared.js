// What the shaders share.

export const HEADER = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
precision highp sampler2DArray; precision highp sampler2DArrayShadow;
const float PI = 3.14159265358979;
const int MOST_LAMPS = 4;

// Fresnel's transmittance into the medium: one less both reflectances, over one denominator (model/fresnel.py).
float transmitted(float cosine, float eta) {
  float c = clamp(cosine, 0., 1.), inverse = 1. / (eta * eta);
  float within = sqrt(max(c * c * inverse + 1. - inverse, 0.));
  float across = eta * within + c, along = eta * c + within, both = max(across * along, 1e-12);
  return 2. * eta * c * within / (both * both) * (across * across + along * along);
}

float luminance(vec3 colour) { return dot(colour, vec3(0.212671, 0.715160, 0.072169)); }

vec3 linearOf(vec3 sRGB) { return mix(pow((sRGB + .055) / 1.055, vec3(2.4)), sRGB / 12.92, lessThan(sRGB, vec3(.04045))); }
`;

/** Lamps, and whether they are seen. A lamp is (position, 1), or (direction to it, 0). */
export const LAMPS = `
uniform sampler2DArrayShadow shadows;
uniform mat4 lampMatrices[MOST_LAMPS];
uniform vec4 lamps[MOST_LAMPS];
uniform vec3 spectra[MOST_LAMPS];
uniform int lampCount;
uniform float bias;

// Direction to a lamp, and by how much its light falls off until there.
vec3 toLamp(vec4 lamp, vec3 p, out float fall) {
  vec3 way = lamp.w > 0. ? lamp.xyz - p : lamp.xyz;
  float far = length(way);
  fall = lamp.w > 0. ? 1. / (far * far) : 1.;
  return way / far;
}

// The part of a lamp that is seen from a place: 1 outside its map.
float seen(int k, vec3 p) {
  vec4 place = lampMatrices[k] * vec4(p, 1.);
  vec3 at = place.xyz / place.w * .5 + .5;
  if (place.w <= 0. || any(greaterThan(abs(at.xy - .5), vec2(.5)))) return 1.;
  return texture(shadows, vec4(at.xy, float(k), min(at.z, 1.) - 1e-5));
}
`;

/** What a texture of the reflectance multiplies entering light by: the texture over the reflectance of the medium. */
export const COLOUR = `
uniform sampler2D colourMap;
uniform vec3 reflectance;
uniform int hasColour;
vec3 colourAt(ivec2 texel) {
  return hasColour == 0 ? vec3(1) : linearOf(texelFetch(colourMap, texel, 0).rgb) / reflectance;
}
`;

/** The mesh: its position, normal and place in the atlas. */
export const MESH = `${HEADER}
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 direction;
layout(location = 2) in vec2 atlas;
uniform mat4 matrix;
uniform vec2 jitter;
out vec3 p;
out vec3 n;
out vec2 uv;
#ifdef BY_VERTEX
uniform sampler2D exitanceOf;
out vec3 exitance;
#endif
void main() {
  p = position; n = direction; uv = atlas;
  gl_Position = matrix * vec4(position, 1.);
  gl_Position.xy += jitter * gl_Position.w;
#ifdef BY_VERTEX
  int width = textureSize(exitanceOf, 0).x;
  exitance = texelFetch(exitanceOf, ivec2(gl_VertexID % width, gl_VertexID / width), 0).rgb;
#endif
}`;
