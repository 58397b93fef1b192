// The texels of the atlas: triangles of the unit square cut into them exactly (scene/atlas/clipping.py and texels.py).

/**
 * The mesh as the page reads it.
 * @typedef {object} Mesh
 * @property {Float32Array} positions three a vertex [scene units] @property {Float32Array} normals three a vertex
 * @property {Float32Array} uv two a vertex, in the unit square @property {Uint32Array} triangles three vertices each
 */

/**
 * The texels that the body covers, row by row; an area of 0 is no texel.
 * @typedef {object} Texels
 * @property {Float32Array} places four each: position, area of the surface in the texel
 * @property {Float32Array} starts four each: where shadow rays start, on the smooth surface
 * @property {Float32Array} directions four each: normal
 * @property {Int32Array} triangle of each texel, -1 for none
 * @property {Float32Array} inside two each: barycentric coordinates of its second and third vertex
 * @property {number} area of the whole surface
 */

/** Pieces of triangles, one for each texel that a triangle touches. */
class Fragments {
  constructor() {
    this.count = 0;
    this.capacity = 1 << 16;
    this.triangle = new Int32Array(this.capacity);
    this.texel = new Int32Array(this.capacity);
    this.area = new Float64Array(this.capacity);
    this.x = new Float64Array(this.capacity);
    this.y = new Float64Array(this.capacity);
  }

  /** @param {number} triangle @param {number} texel @param {number} area @param {number} x @param {number} y */
  add(triangle, texel, area, x, y) {
    if (this.count === this.capacity) this.grow();
    const k = this.count++;
    this.triangle[k] = triangle;
    this.texel[k] = texel;
    this.area[k] = area;
    this.x[k] = x;
    this.y[k] = y;
  }

  grow() {
    this.capacity *= 2;
    for (const name of /** @type {const} */ (["triangle", "texel"])) {
      const larger = new Int32Array(this.capacity);
      larger.set(this[name]);
      this[name] = larger;
    }
    for (const name of /** @type {const} */ (["area", "x", "y"])) {
      const larger = new Float64Array(this.capacity);
      larger.set(this[name]);
      this[name] = larger;
    }
  }
}

const limited = (/** @type {number} */ x) => Math.min(Math.max(x, 0), 1);

/**
 * Integrate 1, x and y over the part of a polygon with the given edges that lies in a strip and in 0 <= x <= 1.
 * Along an edge x clamped to [0, 1] is constant, linear and constant again.
 * @param {number[][]} edges x0, y0, x1, y1 each @param {number} column by which x is moved
 * @returns {[number, number, number]}
 */
function moments(edges, column) {
  let [area, alongX, alongY] = [0, 0, 0];
  for (const [x0, y0, x1, y1] of edges) {
    const dy = y1 - y0;
    if (dy === 0) continue;
    const [a, b] = [x0 - column, x1 - column];
    const inverse = b === a ? 0 : 1 / (b - a);
    const [one, other] = [limited(-a * inverse), limited((1 - a) * inverse)];
    const [s0, s1] = [Math.min(one, other), Math.max(one, other)];
    const [c0, c1] = [limited(a), limited(b)];
    const [within, after] = [s1 - s0, 1 - s1];
    const mean = s0 * c0 + within * 0.5 * (c0 + c1) + after * c1;
    const square = s0 * c0 * c0 + (within * (c0 * c0 + c0 * c1 + c1 * c1)) / 3 + after * c1 * c1;
    const moved = (s0 * s0 * c0 + after * (1 + s1) * c1 + (within * (s0 * (2 * c0 + c1) + s1 * (c0 + 2 * c1))) / 3) / 2;
    area += dy * mean;
    alongX += (dy * square) / 2;
    alongY += dy * (y0 * mean + dy * moved);
  }
  return [area, alongX, alongY];
}

/**
 * Cut one triangle into texels.
 * @param {Fragments} fragments @param {number} triangle @param {number[]} x @param {number[]} y its corners [texels]
 * @param {number} resolution
 */
function cut(fragments, triangle, x, y, resolution) {
  const twice = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
  const last = resolution - 1;
  if (Math.abs(twice) < 2e-12) {
    const [cx, cy] = [(x[0] + x[1] + x[2]) / 3, (y[0] + y[1] + y[2]) / 3];
    fragments.add(triangle, Math.min(Math.floor(cy), last) * resolution + Math.min(Math.floor(cx), last), 0, cx, cy);
    return;
  }
  const order = twice > 0 ? [0, 1, 2] : [0, 2, 1]; // counter-clockwise, so that every area is positive
  const low = Math.floor(Math.min(...y));
  const high = Math.min(Math.max(Math.ceil(Math.max(...y)), low + 1), resolution);
  for (let row = low; row < high; row++) {
    const edges = order.map((corner, k) => {
      const next = order[(k + 1) % 3];
      const [px, py, dx, dy] = [x[corner], y[corner] - row, x[next] - x[corner], y[next] - y[corner]];
      const slope = dy === 0 ? 0 : dx / dy;
      const [y0, y1] = [limited(py), limited(py + dy)];
      return [px + (y0 - py) * slope, y0, px + (y1 - py) * slope, y1];
    });
    const crossing = edges.filter(([, y0, , y1]) => y0 !== y1);
    if (crossing.length === 0) continue;
    const xs = crossing.flatMap(([x0, , x1]) => [x0, x1]);
    const first = Math.max(Math.floor(Math.min(...xs)), 0);
    const end = Math.min(Math.max(Math.ceil(Math.max(...xs)), first + 1), resolution);
    for (let column = first; column < end; column++) {
      const [area, alongX, alongY] = moments(edges, column);
      if (area <= 0) continue;
      fragments.add(triangle, row * resolution + column, area, column + limited(alongX / area), row + limited(alongY / area));
    }
  }
}

/**
 * Cut all triangles of a mesh into the texels of its atlas.
 * @param {Mesh} mesh @param {number} resolution
 * @returns {Texels}
 * Source: CLHHC08 section 3 (position map), eqs. 6 and 7.
 */
export function rasterise(mesh, resolution) {
  const { triangles, uv } = mesh;
  const fragments = new Fragments();
  const count = triangles.length / 3;
  for (let t = 0; t < count; t++) {
    const corners = [triangles[3 * t], triangles[3 * t + 1], triangles[3 * t + 2]];
    const [x, y] = [0, 1].map((k) => corners.map((v) => limited(uv[2 * v + k]) * resolution));
    cut(fragments, t, x, y, resolution);
  }
  const chosen = choose(fragments, mesh, resolution);
  const result = /** @type {Texels} */ ({
    places: new Float32Array(4 * resolution ** 2),
    starts: new Float32Array(4 * resolution ** 2),
    directions: new Float32Array(4 * resolution ** 2),
    triangle: chosen.triangle,
    inside: new Float32Array(2 * resolution ** 2),
    area: chosen.area,
  });
  for (let texel = 0; texel < resolution ** 2; texel++) {
    const t = chosen.triangle[texel];
    if (t < 0) continue;
    describe(result, texel, mesh, t, barycentric(mesh, t, chosen.x[texel] / resolution, chosen.y[texel] / resolution));
    result.places[4 * texel + 3] = chosen.mass[texel];
  }
  return result;
}

/**
 * Find of each texel how much surface lies in it, where that is on average, and the triangle nearest to there.
 * @param {Fragments} fragments @param {Mesh} mesh @param {number} resolution
 */
function choose(fragments, mesh, resolution) {
  const count = mesh.triangles.length / 3;
  const whole = new Float64Array(count);
  for (let k = 0; k < fragments.count; k++) whole[fragments.triangle[k]] += fragments.area[k];
  const surface = Float64Array.from({ length: count }, (_, t) => triangleArea(mesh, t));
  const [mass, x, y] = [0, 1, 2].map(() => new Float64Array(resolution ** 2));
  for (let k = 0; k < fragments.count; k++) {
    const [t, texel] = [fragments.triangle[k], fragments.texel[k]];
    // All of a triangle without an area in the square lies where its point does.
    const share = whole[t] > 0 ? (surface[t] * fragments.area[k]) / whole[t] : surface[t];
    mass[texel] += share;
    x[texel] += share * fragments.x[k];
    y[texel] += share * fragments.y[k];
  }
  const triangle = new Int32Array(resolution ** 2).fill(-1);
  const nearest = new Float64Array(resolution ** 2).fill(Infinity);
  for (let texel = 0; texel < mass.length; texel++) {
    if (mass[texel] === 0) continue;
    x[texel] /= mass[texel];
    y[texel] /= mass[texel];
  }
  for (let k = 0; k < fragments.count; k++) {
    const texel = fragments.texel[k];
    if (mass[texel] === 0) continue;
    const away = (fragments.x[k] - x[texel]) ** 2 + (fragments.y[k] - y[texel]) ** 2;
    if (away >= nearest[texel]) continue;
    nearest[texel] = away;
    triangle[texel] = fragments.triangle[k];
  }
  return { mass, x, y, triangle, area: surface.reduce((sum, value) => sum + value, 0) };
}

/** @param {Mesh} mesh @param {number} t */
function triangleArea({ positions, triangles }, t) {
  const [a, b, c] = [0, 1, 2].map((k) => 3 * triangles[3 * t + k]);
  const [ux, uy, uz] = [0, 1, 2].map((k) => positions[b + k] - positions[a + k]);
  const [vx, vy, vz] = [0, 1, 2].map((k) => positions[c + k] - positions[a + k]);
  return 0.5 * Math.hypot(uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx);
}

/**
 * Turn a place of the unit square into barycentric coordinates of a triangle's second and third corner.
 * @param {Mesh} mesh @param {number} t @param {number} x @param {number} y
 * @returns {[number, number]}
 */
function barycentric({ uv, triangles }, t, x, y) {
  const [a, b, c] = [0, 1, 2].map((k) => 2 * triangles[3 * t + k]);
  const [e, f, g, h] = [uv[b] - uv[a], uv[b + 1] - uv[a + 1], uv[c] - uv[a], uv[c + 1] - uv[a + 1]];
  const twice = e * h - f * g;
  if (twice === 0) return [1 / 3, 1 / 3];
  const [dx, dy] = [x - uv[a], y - uv[a + 1]];
  const second = limited((h * dx - g * dy) / twice);
  return [second, Math.min(Math.max((e * dy - f * dx) / twice, 0), 1 - second)];
}

/**
 * Write where a place of a triangle lies, its normal, and where it lies on the smooth surface that the vertex normals
 * describe: p + sum_i b_i max(0, (v_i - p) . n_i) n_i.
 * @param {Texels} texels @param {number} texel @param {Mesh} mesh @param {number} t @param {[number, number]} inside
 * Source: J. Hanika, Hacking the shadow terminator, Ray Tracing Gems II (2021), chapter 4.
 */
function describe(texels, texel, { positions, normals, triangles }, t, inside) {
  const weights = [1 - inside[0] - inside[1], inside[0], inside[1]];
  const corners = [0, 1, 2].map((k) => 3 * triangles[3 * t + k]);
  const mean = (/** @type {Float32Array} */ values) =>
    [0, 1, 2].map((k) => corners.reduce((sum, v, i) => sum + weights[i] * values[v + k], 0));
  const p = mean(positions);
  const n = mean(normals);
  const length = Math.hypot(...n) || 1;
  const start = [...p];
  corners.forEach((v, i) => {
    const depth = [0, 1, 2].reduce((sum, k) => sum + (positions[v + k] - p[k]) * normals[v + k], 0);
    if (depth > 0) for (let k = 0; k < 3; k++) start[k] += weights[i] * depth * normals[v + k];
  });
  texels.places.set(p, 4 * texel);
  texels.starts.set(start, 4 * texel);
  texels.directions.set([n[0] / length, n[1] / length, n[2] / length], 4 * texel);
  texels.inside.set(inside, 2 * texel);
}
