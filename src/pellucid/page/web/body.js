// The body: its mesh and its texels on the device.

import { rasterise } from "./atlas.js";

/** @import { Device, Program, Texture, Values } from "./device.js" */
/** @import { Mesh, Texels } from "./atlas.js" */
/** @import { Planes } from "./data.js" */
/** @import { Vector } from "./vectors.js" */

/**
 * What the exporter says about the body.
 * @typedef {object} BodyHead
 * @property {Vector} low corner of its box [scene units] @property {Vector} size of its box
 * @property {number} normalSteps @property {number} placeSteps @property {number} resolution of the atlas
 */

const COEFFICIENTS = 9; // of spherical harmonics
const SUMMED_WIDTH = 128; // of the textures with a texel for each vertex

/**
 * Turn what the exporter packed into positions, normals and places in the atlas.
 * @param {BodyHead} head @param {Planes} planes
 * @returns {Mesh}
 */
export function unpackMesh({ low, size, normalSteps, placeSteps }, planes) {
  const count = planes.x.length;
  const [positions, normals, uv] = [new Float32Array(3 * count), new Float32Array(3 * count), new Float32Array(2 * count)];
  for (let k = 0; k < count; k++) {
    [planes.x, planes.y, planes.z].forEach(
      (plane, axis) => (positions[3 * k + axis] = low[axis] + (size[axis] * plane[k]) / 65535),
    );
    uv.set([planes.u[k] / placeSteps, planes.v[k] / placeSteps], 2 * k);
    normals.set(fromOctahedron((2 * planes.nx[k]) / normalSteps - 1, (2 * planes.ny[k]) / normalSteps - 1), 3 * k);
  }
  return { positions, normals, uv, triangles: new Uint32Array(planes.triangles.buffer) };
}

/**
 * Fold a square into a unit vector: an octahedron, blown up.
 * @param {number} x @param {number} y in [-1, 1]
 */
function fromOctahedron(x, y) {
  const z = 1 - Math.abs(x) - Math.abs(y);
  const fold = Math.max(-z, 0);
  const v = [x + (x >= 0 ? -fold : fold), y + (y >= 0 ? -fold : fold), z];
  const length = Math.hypot(...v);
  return v.map((value) => value / length);
}

export class Body {
  /**
   * @param {Device} device @param {BodyHead} head @param {Mesh} mesh @param {Texels} texels
   * @param {Int8Array | undefined} openness of the vertices: how much of each spherical harmonic of the sky enters
   * @param {ImageBitmap | null} colours the reflectance of the texels
   */
  constructor(device, head, mesh, texels, openness, colours) {
    const { gl } = device;
    this.device = device;
    this.mesh = mesh;
    this.texels = texels;
    this.openness = openness;
    this.resolution = head.resolution;
    this.area = texels.area;
    /** Side of a square that has the mean area of the texels [scene units]. */
    this.spacing = Math.sqrt(texels.area / texels.triangle.filter((t) => t >= 0).length);
    this.extent = Math.max(...head.size);
    this.centre = head.low.map((low, k) => low + head.size[k] / 2);
    this.radius = ball(mesh.positions, this.centre);
    this.triangles = mesh.triangles.length / 3;
    this.vertices = mesh.positions.length / 3;
    this.vertexArray = gl.createVertexArray();
    gl.bindVertexArray(this.vertexArray);
    [mesh.positions, mesh.normals, mesh.uv].forEach((values, k) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(k);
      gl.vertexAttribPointer(k, k < 2 ? 3 : 2, gl.FLOAT, false, 0, 0);
      device.bytes += values.byteLength;
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.triangles, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    const r = this.resolution;
    /** What passes read of the texels. @type {Values & {sky: Texture, places: Texture}} */
    this.maps = {
      places: device.upload(r, r, texels.places),
      starts: device.upload(r, r, texels.starts),
      directions: device.upload(r, r, texels.directions),
      sky: device.upload(1, 1, new Float32Array(4)),
      colourMap: device.texture("RGBA8", colours ? r : 1, colours ? r : 1),
      hasColour: Number(!!colours),
    };
    if (colours) {
      gl.bindTexture(gl.TEXTURE_2D, /** @type {Texture} */ (this.maps.colourMap).handle);
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, gl.RGBA, gl.UNSIGNED_BYTE, colours);
    }
    this.vertexPlaces = this.asTexels(mesh.positions);
    this.vertexNormals = this.asTexels(mesh.normals);
  }

  /** Upload vectors of the vertices, to sum there: four numbers each, the last is 1. @param {Float32Array} vectors */
  asTexels(vectors) {
    const rows = Math.ceil(this.vertices / SUMMED_WIDTH);
    const values = new Float32Array(4 * SUMMED_WIDTH * rows);
    for (let k = 0; k < this.vertices; k++) values.set([vectors[3 * k], vectors[3 * k + 1], vectors[3 * k + 2], 1], 4 * k);
    return this.device.upload(SUMMED_WIDTH, rows, values);
  }

  /** @returns {Values} the vertices, as sums read what is seen */
  get vertexValues() {
    return { seenPlaces: this.vertexPlaces, seenNormals: this.vertexNormals };
  }

  /**
   * Draw the triangles; of those that face away, or to the eye, none.
   * @param {Program} program @param {Values} values @param {number} culled
   */
  draw(program, values, culled) {
    const { gl } = this.device;
    gl.enable(gl.CULL_FACE);
    gl.cullFace(culled);
    gl.disable(gl.BLEND);
    this.device.use(program, values);
    gl.bindVertexArray(this.vertexArray);
    gl.drawElements(gl.TRIANGLES, this.mesh.triangles.length, gl.UNSIGNED_INT, 0);
  }

  /**
   * Let a sky shine on the texels: irradiance that enters, from radiance in nine spherical harmonics; null for none.
   * @param {Vector[] | null} radiance nine colours @param {number} scale of the openness
   */
  setSky(radiance, scale) {
    this.device.free(this.maps.sky);
    if (!radiance || !this.openness) {
      this.maps.sky = this.device.upload(1, 1, new Float32Array(4));
      return;
    }
    const [atVertices, values] = [new Float32Array(3 * this.vertices), new Float32Array(4 * this.resolution ** 2)];
    for (let v = 0; v < this.vertices; v++) {
      for (let channel = 0; channel < 3; channel++) {
        let sum = 0;
        for (let k = 0; k < COEFFICIENTS; k++) sum += radiance[k][channel] * this.openness[k * this.vertices + v];
        atVertices[3 * v + channel] = Math.max(sum * scale, 0);
      }
    }
    const { triangle, inside } = this.texels;
    for (let texel = 0; texel < triangle.length; texel++) {
      if (triangle[texel] < 0) continue;
      const [a, b, c] = [0, 1, 2].map((k) => 3 * this.mesh.triangles[3 * triangle[texel] + k]);
      const [second, third] = [inside[2 * texel], inside[2 * texel + 1]];
      for (let k = 0; k < 3; k++) {
        values[4 * texel + k] = (1 - second - third) * atVertices[a + k] + second * atVertices[b + k] + third * atVertices[c + k];
      }
    }
    this.maps.sky = this.device.upload(this.resolution, this.resolution, values);
  }
}

/** @param {Float32Array} positions @param {Vector} centre */
function ball(positions, centre) {
  let most = 0;
  for (let k = 0; k < positions.length; k += 3) {
    most = Math.max(
      most,
      (positions[k] - centre[0]) ** 2 + (positions[k + 1] - centre[1]) ** 2 + (positions[k + 2] - centre[2]) ** 2,
    );
  }
  return Math.sqrt(most);
}

/** @param {Device} device @param {BodyHead} head @param {Planes} planes @param {ImageBitmap | null} colours */
export function makeBody(device, head, planes, colours) {
  const mesh = unpackMesh(head, planes);
  return new Body(
    device,
    head,
    mesh,
    rasterise(mesh, head.resolution),
    /** @type {Int8Array | undefined} */ (planes.openness),
    colours,
  );
}
