// When pictures are made: while something moves as fast as the screen shows them, at rest 16 that are averaged, then none.

import { PASSES } from "../engine.js";
import { tooNear } from "../near_lamps.js";
import { Pace } from "./pace.js";

/** @import { Camera } from "../framing.js" */
/** @import { Engine, Mode, State } from "../engine.js" */

const SETTLE = 200; // milliseconds without a change after which the settled picture is begun
const AT_ONCE = 0.1; // seconds that a draw may take: drivers end those of a few seconds
const NAMES = { pixels: "every pixel", quarter: "1 of 4 pixels", sixteenth: "1 of 16 pixels", vertices: "the vertices" };

/**
 * @typedef {object} Scenery
 * @property {(aspect: number) => {engine: Engine, state: State, camera: Camera, mode: "auto" | Mode}} now
 * @property {(text: string) => void} say @property {() => void} shown  after each picture
 * @property {(error: Error) => void} failed
 */

export class Loop {
  /** @param {HTMLCanvasElement} canvas @param {Scenery} scenery */
  constructor(canvas, scenery) {
    this.canvas = canvas;
    this.scenery = scenery;
    this.pace = new Pace();
    this.pass = 0;
    this.moved = -Infinity;
    this.isQueued = false;
    this.isStopped = false;
    this.frames = 0;
    this.warning = "";
    /** @type {Generator<void> | null} */
    this.job = null;
    /** @type {{sync: WebGLSync, begin: number, pairs: number} | null} */
    this.waiting = null;
    new ResizeObserver(() => this.changed()).observe(canvas);
    document.addEventListener("visibilitychange", () => this.ask());
    this.watchRatio();
  }

  /** A window that moves to another screen may have another number of pixels. */
  watchRatio() {
    const query = matchMedia(`(resolution: ${devicePixelRatio}dppx)`);
    query.addEventListener("change", () => (this.changed(), this.watchRatio()), { once: true });
  }

  /** Something has changed: draw. */
  changed() {
    this.moved = performance.now();
    this.pass = 0;
    this.job?.return(undefined);
    this.job = null;
    this.ask();
  }

  ask() {
    if (this.isQueued || this.isStopped || document.hidden) return;
    this.isQueued = true;
    requestAnimationFrame(() => {
      this.isQueued = false;
      if (this.isStopped || document.hidden) return;
      try {
        this.tick();
      } catch (error) {
        this.stop();
        this.scenery.failed(/** @type {Error} */ (error));
      }
    });
  }

  /** @returns {[number, number]} pixels of the picture */
  size() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const limit = (/** @type {number} */ length) => Math.min(Math.max(8, Math.round(length * ratio)), 4096);
    return [limit(this.canvas.clientWidth), limit(this.canvas.clientHeight)];
  }

  tick() {
    const [width, height] = this.size();
    const { engine, state, camera, mode: wanted } = this.scenery.now(width / height);
    const { gl } = engine.device;
    if (gl.isContextLost()) return;
    if (!this.finished(gl)) return this.ask(); // the device is behind: one frame at a time
    const isMoving = performance.now() - this.moved < SETTLE;
    const mode = isMoving ? (wanted === "auto" ? this.pace.mode(engine, state, width, height) : wanted) : "pixels";
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
    if (isMoving) this.pass = 0;
    const before = engine.pairs;
    const begin = performance.now();
    this.job ??= engine.picture(
      state,
      camera,
      width,
      height,
      mode,
      this.pass,
      isMoving ? Infinity : (this.pace.rate * AT_ONCE) / this.pace.covered,
    );
    const isDone = this.job.next().done;
    this.waiting = {
      sync: /** @type {WebGLSync} */ (gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0)),
      begin,
      pairs: (engine.pairs - before) * this.pace.covered,
    };
    gl.flush();
    if (!isDone) return this.ask();
    this.job = null;
    this.frames++;
    this.report(engine, state, width, height, mode, isMoving);
    this.scenery.shown();
    if (!isMoving) this.pass++;
    if (this.pass < PASSES) this.ask();
  }

  /** Ask whether the device has drawn the last frame, and learn how long that took. @param {WebGL2RenderingContext} gl */
  finished(gl) {
    if (!this.waiting) return true;
    const { sync, begin, pairs } = this.waiting;
    if (gl.clientWaitSync(sync, 0, 0) === gl.TIMEOUT_EXPIRED) return false;
    gl.deleteSync(sync);
    this.waiting = null;
    this.pace.learn(pairs, (performance.now() - begin) / 1000);
    return true;
  }

  /**
   * @param {Engine} engine @param {State} state @param {number} width @param {number} height @param {Mode} mode @param {boolean} isMoving
   */
  report(engine, state, width, height, mode, isMoving) {
    if (!isMoving && this.pass === 0) this.pace.covered = engine.covered() || this.pace.covered;
    const pairs = Math.round(width * height * this.pace.covered * engine.pairsPerPoint(state));
    const settled = isMoving
      ? `sums at ${NAMES[mode]}`
      : this.pass + 1 < PASSES
        ? `settling, ${this.pass + 1} of ${PASSES}`
        : `settled, ${(pairs / 1e6).toFixed(0)} million pairs a picture`;
    if (engine.memory.changed("near lamps", [state.lamps, state.millimetres])) {
      this.warning = tooNear(engine.body, state.lamps, state.millimetres / engine.body.extent);
    }
    this.scenery.say([`${width} × ${height} · N ${state.samples} · ${settled}`, this.warning].filter(Boolean).join(" · "));
  }

  /** Make no more pictures, until `start`. */
  stop() {
    this.isStopped = true;
    this.job = this.waiting = null;
  }

  start() {
    this.isStopped = false;
    this.changed();
  }
}
