// WebGL2 with fewer words: programs with their uniforms, textures, targets, and passes over all pixels.

/**
 * @typedef {{program: WebGLProgram, uniforms: Map<string, {type: number, at: WebGLUniformLocation | null}>}} Program
 * @typedef {{handle: WebGLTexture, width: number, height: number, layers: number, bytes: number, kind: number, format: number}} Texture
 * @typedef {Record<string, number | number[] | Float32Array | Texture>} Values
 */

/** Said where a browser cannot show the page. */
export class Unsupported extends Error {}

const FULL_SCREEN = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1., 0., 1.); }`;

/** Bytes of a texel by format. */
const SIZES = /** @type {Record<string, number>} */ ({
  RGBA32F: 16,
  RGBA16F: 8,
  RG32F: 8,
  RG16F: 4,
  RGBA8: 4,
  DEPTH_COMPONENT24: 4,
});

export class Device {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    const options = {
      antialias: false,
      alpha: false,
      depth: false,
      preserveDrawingBuffer: true,
      powerPreference: "high-performance",
    };
    const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", options));
    if (!gl) throw new Unsupported("This browser has no WebGL2.");
    if (!gl.getExtension("EXT_color_buffer_float")) {
      throw new Unsupported("This device cannot draw into textures of floats (EXT_color_buffer_float).");
    }
    this.gl = gl;
    /** Whether textures of 32-bit floats can be looked up between their texels; else the profile has 16 bits. */
    this.filtersFloats = !!gl.getExtension("OES_texture_float_linear");
    /** Memory of all textures [bytes]. */
    this.bytes = 0;
    this.vertices = gl.createVertexArray(); // of passes without vertices of their own
    /** @type {Map<string, Program>} */
    this.programs = new Map();
  }

  /**
   * Compile a program, once; `defines` are names that its shaders ask for.
   * @param {string} name for messages @param {string} fragment @param {string} [vertex] @param {string[]} [defines]
   * @returns {Program}
   */
  program(name, fragment, vertex = FULL_SCREEN, defines = []) {
    const key = [name, ...defines].join(" ");
    const known = this.programs.get(key);
    if (known) return known;
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of /** @type {[number, string][]} */ ([
      [gl.VERTEX_SHADER, vertex],
      [gl.FRAGMENT_SHADER, fragment],
    ])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      const lines = defines.map((define) => `#define ${define}\n`).join("");
      gl.shaderSource(shader, text.replace(/^#version 300 es\n/, `#version 300 es\n${lines}`));
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = (gl.getAttachedShaders(program) ?? []).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`${key}: ${gl.getProgramInfoLog(program)} ${logs.join(" ")}`);
    }
    const uniforms = new Map();
    const count = gl.isContextLost() ? 0 : gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let k = 0; k < count; k++) {
      const info = /** @type {WebGLActiveInfo} */ (gl.getActiveUniform(program, k));
      uniforms.set(info.name.replace("[0]", ""), { type: info.type, at: gl.getUniformLocation(program, info.name) });
    }
    const result = { program, uniforms };
    this.programs.set(key, result);
    return result;
  }

  /**
   * Use a program with values for its uniforms; values that it does not have are left out.
   * @param {Program} program @param {Values} values
   */
  use({ program, uniforms }, values) {
    const gl = this.gl;
    gl.useProgram(program);
    let unit = 0;
    for (const [name, { type, at }] of uniforms) {
      const value = /** @type {any} */ (values[name]);
      if (value === undefined) throw new Error(`no value for the uniform ${name}`);
      if (value.handle) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(value.kind, value.handle);
        gl.uniform1i(at, unit++);
      } else if (type === gl.FLOAT) gl.uniform1f(at, value);
      else if (type === gl.INT || type === gl.BOOL) gl.uniform1i(at, Number(value));
      else if (type === gl.FLOAT_VEC2) gl.uniform2fv(at, value);
      else if (type === gl.FLOAT_VEC3) gl.uniform3fv(at, value);
      else if (type === gl.FLOAT_VEC4) gl.uniform4fv(at, value);
      else gl.uniformMatrix4fv(at, false, value);
    }
  }

  /**
   * Make a texture; with `layers` an array of them.
   * @param {"RGBA32F" | "RGBA16F" | "RG32F" | "RG16F" | "RGBA8" | "DEPTH_COMPONENT24"} format @param {number} width @param {number} height
   * @param {{levels?: number, layers?: number, linear?: boolean, compare?: boolean}} [options]
   * @returns {Texture}
   */
  texture(format, width, height, { levels = 1, layers = 0, linear = false, compare = false } = {}) {
    const gl = this.gl;
    const handle = gl.createTexture();
    const kind = layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
    gl.bindTexture(kind, handle);
    if (layers) gl.texStorage3D(kind, levels, gl[format], width, height, layers);
    else gl.texStorage2D(kind, levels, gl[format], width, height);
    const between = levels > 1 ? gl.NEAREST_MIPMAP_NEAREST : gl.NEAREST;
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, linear ? gl.LINEAR : between);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, linear ? gl.LINEAR : gl.NEAREST);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    if (compare) gl.texParameteri(kind, gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE);
    const bytes = SIZES[format] * width * height * Math.max(layers, 1) * (levels > 1 ? 4 / 3 : 1);
    this.bytes += bytes;
    return { handle, width, height, layers, bytes, kind, format: gl[format] };
  }

  /**
   * Make a texture of 32-bit floats, four a texel.
   * @param {number} width @param {number} height @param {Float32Array} values
   */
  upload(width, height, values) {
    const gl = this.gl;
    const texture = this.texture("RGBA32F", width, height);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, gl.RGBA, gl.FLOAT, values);
    return texture;
  }

  /** @param {(Texture | null | undefined)[]} textures */
  free(...textures) {
    for (const texture of textures) {
      if (!texture) continue;
      this.gl.deleteTexture(texture.handle);
      this.bytes -= texture.bytes;
    }
  }

  /**
   * Make a target of colours and a depth; of mipmapped textures one level, of arrays one layer.
   * @param {Texture[]} colours @param {Texture | null} [depth] @param {number} [place] level or layer
   * @returns {WebGLFramebuffer}
   */
  target(colours, depth = null, place = 0) {
    const gl = this.gl;
    const target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    const attach = (/** @type {number} */ point, /** @type {Texture} */ texture) => {
      if (texture.layers) gl.framebufferTextureLayer(gl.FRAMEBUFFER, point, texture.handle, 0, place);
      else gl.framebufferTexture2D(gl.FRAMEBUFFER, point, gl.TEXTURE_2D, texture.handle, depth ? 0 : place);
    };
    colours.forEach((texture, k) => attach(gl.COLOR_ATTACHMENT0 + k, texture));
    if (depth) attach(gl.DEPTH_ATTACHMENT, depth);
    gl.drawBuffers(colours.length ? colours.map((_, k) => gl.COLOR_ATTACHMENT0 + k) : [gl.NONE]);
    const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER);
    if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost())
      throw new Unsupported(`This device cannot draw into a texture it made (0x${status.toString(16)}).`);
    return target;
  }

  /**
   * Run a program at every pixel of a target; null is the canvas.
   * @param {WebGLFramebuffer | null} target @param {number} width @param {number} height
   * @param {Program} program @param {Values} values
   */
  everywhere(target, width, height, program, values) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.CULL_FACE);
    gl.bindVertexArray(this.vertices);
    this.use(program, values);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /**
   * Read a texture of floats back: rows from the bottom up, four numbers a texel.
   * @param {Texture} texture @param {number} [level]
   */
  read(texture, level = 0) {
    const gl = this.gl;
    const [width, height] = [Math.max(texture.width >> level, 1), Math.max(texture.height >> level, 1)];
    const target = this.target([texture], null, level);
    const values = new Float32Array(4 * width * height);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
    gl.deleteFramebuffer(target);
    return values;
  }
}
