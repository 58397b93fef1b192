/* Photons walk through a body until they leave it: where, and after how many collisions.

   walk shape size g eta photons orders seed file

   Nothing is absorbed, so that one walk serves every albedo: with H[face][ring][order] per unit of entering flux, the light that leaves
   within a ring around the point of entry is sum over orders of albedo^order H. The unit of size, of rings and of `orders` is the
   reduced mean free path 1 / (sigma_t (1 - g)); light enters diffusely, through a smooth boundary of relative index eta.

   shape 0 half space, 1 slab of a thickness, 2 sphere of a radius, 3 cylinder of a radius, 4 cube of an edge (light enters anywhere on the
   face z = 0). face 0 where light enters, 1 the far side of a slab or cube, 2 the other sides of a cube.

   The number of photons is halved by Russian roulette whenever their order has grown fourfold: late light costs as much as early light.
   The file, of doubles: shape, size, g, eta, photons, light left after the last order; then sums of weights and of their squares by face,
   ring, order; then the mean order of each bin of orders. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

enum { PER_OCTAVE = 8, FIRST = -10, RINGS = 161, SINGLE_ORDERS = 32, ORDERS = 224, FACES = 3 };

typedef struct { float x, y, z; } Vector;

static double weights[FACES][RINGS][ORDERS], squares[FACES][RINGS][ORDERS], order_sum[ORDERS], weight_sum[ORDERS];
static uint64_t state[4];

static uint64_t splitmix(uint64_t *seed) {
  uint64_t z = (*seed += 0x9e3779b97f4a7c15ull);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
  return z ^ (z >> 31);
}

/* xoshiro256+ (Blackman, Vigna 2018): uniform in (0, 1). */
static inline float uniform(void) {
  uint64_t result = state[0] + state[3], shifted = state[1] << 17;
  state[2] ^= state[0], state[3] ^= state[1], state[1] ^= state[2], state[0] ^= state[3];
  state[2] ^= shifted, state[3] = (state[3] << 45) | (state[3] >> 19);
  return ((result >> 40) + 0.5f) * 0x1p-24f;
}

static inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

static inline Vector along(Vector p, float t, Vector d) { return (Vector){p.x + t * d.x, p.y + t * d.y, p.z + t * d.z}; }

/* Fresnel reflectance, light on the side of cosine c, refracted to a medium of index `ratio` times its own. */
static inline float fresnel(float c, float ratio) {
  float refracted2 = 1 - (1 - c * c) / (ratio * ratio);
  if (refracted2 <= 0) return ratio == 1 ? 0 : 1;
  float t = sqrtf(refracted2), s = (c - ratio * t) / (c + ratio * t + 1e-30f), p = (ratio * c - t) / (ratio * c + t + 1e-30f);
  return 0.5f * (s * s + p * p);
}

static inline void unit_circle(float *x, float *y) {
  float r2;
  do { *x = 2 * uniform() - 1, *y = 2 * uniform() - 1, r2 = *x * *x + *y * *y; } while (r2 >= 1 || r2 < 1e-12f);
  float scale = 1 / sqrtf(r2);
  *x *= scale, *y *= scale;
}

static inline Vector enter(float eta) {
  for (;;) {
    float sine2 = uniform();
    if (uniform() < fresnel(sqrtf(1 - sine2), eta)) continue;
    float sine = sqrtf(sine2) / eta, a, b;
    unit_circle(&a, &b);
    return (Vector){sine * a, sine * b, sqrtf(1 - sine * sine)};
  }
}

/* Henyey and Greenstein 1941. */
static inline Vector scatter(Vector d, float g) {
  float a, b, u = uniform(), cosine = 1 - 2 * u;
  if (g != 0) {
    float k = (1 - g * g) / (1 - g + 2 * g * u);
    cosine = fmaxf(-1, fminf(1, (1 + g * g - k * k) / (2 * g)));
  }
  float sine = sqrtf(1 - cosine * cosine), sign = d.z >= 0 ? 1.f : -1.f, q = -1 / (sign + d.z), w = d.x * d.y * q;
  unit_circle(&a, &b);
  a *= sine, b *= sine;
  Vector e = {(1 + sign * d.x * d.x * q) * a + w * b + d.x * cosine, sign * w * a + (sign + d.y * d.y * q) * b + d.y * cosine,
              -sign * d.x * a - d.y * b + d.z * cosine};
  float scale = 1 / sqrtf(dot(e, e));
  return (Vector){scale * e.x, scale * e.y, scale * e.z};
}

/* Distance from inside a unit of curvature: the larger root of |q|^2 + 2 t q.d + t^2 d.d = radius^2 over the components kept in q, d. */
static inline float to_round(Vector q, Vector d, float radius) {
  float a = dot(d, d), b = dot(q, d), c = dot(q, q) - radius * radius, root = b * b - a * c;
  return a > 1e-12f ? fmaxf(0, (-b + sqrtf(fmaxf(root, 0))) / a) : 1e30f;
}

/* Distance to the surface, with the face met there. */
static inline float to_surface(int shape, float size, Vector p, Vector d, int *face) {
  float depth = d.z < 0 ? -p.z / d.z : shape == 0 || d.z == 0 ? 1e30f : (size - p.z) / d.z;
  *face = d.z < 0 ? 0 : 1;
  if (shape < 2) return fmaxf(depth, 0);
  if (shape < 4) {
    *face = 0;
    return to_round((Vector){p.x, shape == 2 ? p.y : 0, p.z - size}, (Vector){d.x, shape == 2 ? d.y : 0, d.z}, size);
  }
  float x = d.x > 0 ? (size - p.x) / d.x : d.x < 0 ? -p.x / d.x : 1e30f;
  float y = d.y > 0 ? (size - p.y) / d.y : d.y < 0 ? -p.y / d.y : 1e30f;
  if (fminf(x, y) < depth) depth = fminf(x, y), *face = 2;
  return fmaxf(depth, 0);
}

/* Outward normal where a photon meets the surface, which is put on it to the last digit. */
static inline Vector normal_at(int shape, float size, Vector *p, Vector d, int face) {
  if (shape < 2 || (shape == 4 && face < 2)) {
    p->z = face ? size : 0;
    return (Vector){0, 0, face ? 1 : -1};
  }
  if (shape == 4) {
    float x = d.x > 0 ? size - p->x : d.x < 0 ? p->x : 1e30f, y = d.y > 0 ? size - p->y : d.y < 0 ? p->y : 1e30f;
    return x < y ? (Vector){d.x > 0 ? 1 : -1, 0, 0} : (Vector){0, d.y > 0 ? 1 : -1, 0};
  }
  Vector q = {p->x, shape == 2 ? p->y : 0, p->z - size};
  float scale = 1 / sqrtf(dot(q, q));
  Vector n = {q.x * scale, q.y * scale, q.z * scale};
  *p = (Vector){n.x * size, shape == 2 ? n.y * size : p->y, n.z * size + size};
  return n;
}

static inline int ring_of(float r) {
  int ring = (int)floorf((log2f(r + 1e-30f) - FIRST) * PER_OCTAVE) + 1;
  return ring < 0 ? 0 : ring < RINGS ? ring : RINGS - 1;
}

static inline int bin_of(uint32_t order) {
  int bin = order < SINGLE_ORDERS ? (int)order : SINGLE_ORDERS + (int)((log2f((float)order / SINGLE_ORDERS)) * 2 * PER_OCTAVE);
  return bin < ORDERS ? bin : ORDERS - 1;
}

/* One photon; returns the light it still carries after the last order. */
static float walk(int shape, float size, float g, float eta, uint32_t last) {
  Vector p = {0, 0, 0}, start, d = enter(eta);
  if (shape == 4) p.x = size * uniform(), p.y = size * uniform();
  start = p;
  uint32_t order = 0, roulette = (uint32_t)(4 / (1 - g));
  float weight = 1;
  for (;;) {
    int face;
    float flight = -logf(uniform()), distance = to_surface(shape, size, p, d, &face);
    if (distance <= flight) {
      p = along(p, distance, d);
      Vector n = normal_at(shape, size, &p, d, face);
      float cosine = fmaxf(0, dot(d, n));
      if (uniform() >= fresnel(cosine, 1 / eta)) {
        Vector away = along(p, -1, start);
        int ring = ring_of(sqrtf(dot(away, away)) * (1 - g)), bin = bin_of(order);
        weights[face][ring][bin] += weight, squares[face][ring][bin] += weight * weight;
        order_sum[bin] += (double)weight * order, weight_sum[bin] += weight;
        return 0;
      }
      d = along(d, -2 * cosine, n);
      continue;
    }
    p = along(p, flight, d);
    if (p.z < 0) p.z = 0;
    if (++order > last) return weight;
    if (order == roulette) {
      if (uniform() < 0.5f) return 0;
      weight *= 2, roulette *= 4;
    }
    d = scatter(d, g);
  }
}

int main(int count, char **argument) {
  if (count != 9) return fprintf(stderr, "walk shape size g eta photons orders seed file\n"), 2;
  int shape = atoi(argument[1]);
  float g = atof(argument[3]), eta = atof(argument[4]), size = atof(argument[2]) / (1 - g);
  long photons = atol(argument[5]);
  uint32_t last = (uint32_t)(atof(argument[6]) / (1 - g));
  uint64_t seed = strtoull(argument[7], 0, 10);
  for (int i = 0; i < 4; i++) state[i] = splitmix(&seed);
  double left = 0;
  for (long i = 0; i < photons; i++) left += walk(shape, size, g, eta, last);
  for (int i = 0; i < ORDERS; i++) order_sum[i] = weight_sum[i] > 0 ? order_sum[i] / weight_sum[i] : 1;
  double head[] = {shape, size * (1 - g), g, eta, photons, left};
  FILE *file = fopen(argument[8], "wb");
  if (!file) return perror(argument[8]), 1;
  fwrite(head, sizeof head, 1, file), fwrite(weights, sizeof weights, 1, file), fwrite(squares, sizeof squares, 1, file);
  fwrite(order_sum, sizeof order_sum, 1, file);
  return fclose(file) != 0;
}
