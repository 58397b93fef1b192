// What the exporter packed (page/packing.py): planes of numbers, deflated, in base64.

/**
 * A plane of numbers: `count` of a type, as `code` says: themselves, their differences,
 * or how far they are below the first whole number that has not come yet.
 * @typedef {{name: string, type: "u8" | "i8" | "u16" | "u32" | "f32", count: number, code: string}} Plane
 * @typedef {Record<string, Uint8Array | Int8Array | Uint16Array | Int32Array | Float32Array>} Planes
 */

const BYTES = { u8: 1, i8: 1, u16: 2, u32: 4, f32: 4 };

/**
 * Inflate and decode planes.
 * @param {Plane[]} planes @param {string} base64
 * @returns {Promise<Planes>}
 */
export async function unpack(planes, base64) {
  const packed = Uint8Array.from(atob(base64.trim()), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  /** @type {Planes} */
  const result = {};
  let at = 0;
  for (const plane of planes) {
    result[plane.name] = decode(plane, bytes.subarray(at, at + plane.count * BYTES[plane.type]));
    at += plane.count * BYTES[plane.type];
  }
  return result;
}

/**
 * Put the bytes of numbers together, the lowest bytes of all come first, and undo their code.
 * @param {Plane} plane @param {Uint8Array} bytes
 */
function decode({ type, count, code }, bytes) {
  const size = BYTES[type];
  const joined = new Uint8Array(count * size);
  for (let k = 0; k < count; k++) for (let byte = 0; byte < size; byte++) joined[k * size + byte] = bytes[byte * count + k];
  const kinds = { u8: Uint8Array, i8: Int8Array, u16: Uint16Array, u32: Int32Array, f32: Float32Array };
  const values = new kinds[type](joined.buffer);
  if (code === "delta") for (let k = 1; k < count; k++) values[k] += values[k - 1]; // typed arrays wrap around, as the encoder did
  if (code === "newest") for (let k = 0, known = -1; k < count; k++) known = Math.max(known, (values[k] = known + 1 - values[k]));
  return values;
}
