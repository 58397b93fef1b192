// Pointers and keys on the picture: the camera turns, moves, comes nearer; lamps have handles of their own.

import { add, clamp, cross, dot, subtract, times, turned, unit } from "../vectors.js";

/** @import { Camera } from "../framing.js" */
/** @import { PageState } from "./state.js" */
/** @import { Lamp } from "../passes/shadow.js" */
/** @import { Vector } from "../vectors.js" */

const STEP = 0.12; // of a key, in radians
const STEEPEST = 0.995; // cosine between the view and the vertical
const HANDLE = 1.3; // radii of the body from its middle to the handle of a lamp
const RANGE = [0.05, 200]; // distances of the camera, in radii

/** @param {Camera} camera */
function frameOf(camera) {
  const forward = unit(subtract(camera.target, camera.origin));
  const right = unit(cross(forward, camera.up));
  return { forward, right, up: cross(right, forward) };
}

/**
 * Look through a window of another shape: one that is narrower than the camera's shows as much across, and more above.
 * @param {Camera} camera @param {number} aspect of its own pictures @param {number} wanted width over height
 * @returns {Camera}
 */
export function fitted(camera, aspect, wanted) {
  const half = Math.tan((camera.fov * Math.PI) / 360) * Math.max(aspect / wanted, 1);
  return { ...camera, fov: (Math.atan(half) * 360) / Math.PI };
}

/** @param {Camera} camera @param {number} x @param {number} y angles to the right and up */
export function orbit(camera, x, y) {
  const axis = unit(camera.up);
  let arm = turned(subtract(camera.origin, camera.target), axis, -x);
  const tilted = turned(arm, unit(cross(axis, arm)), -y);
  if (Math.abs(dot(unit(tilted), axis)) < STEEPEST) arm = tilted;
  camera.origin = add(camera.target, arm);
}

/** @param {Camera} camera @param {number} x @param {number} y shares of the height of the picture */
export function pan(camera, x, y) {
  const { right, up } = frameOf(camera);
  const height = 2 * Math.tan((camera.fov * Math.PI) / 360) * Math.hypot(...subtract(camera.origin, camera.target));
  const step = add(times(right, -x * height), times(up, y * height));
  camera.origin = add(camera.origin, step);
  camera.target = add(camera.target, step);
}

/** @param {Camera} camera @param {number} factor on the distance @param {number} radius of the body */
export function zoom(camera, factor, radius) {
  const arm = subtract(camera.origin, camera.target);
  const distance = Math.hypot(...arm);
  camera.origin = add(camera.target, times(arm, clamp(distance * factor, RANGE[0] * radius, RANGE[1] * radius) / distance));
}

/**
 * Move a lamp around the body as the hand moves over the picture.
 * @param {Lamp} lamp @param {Camera} camera @param {Vector} centre @param {number} x @param {number} y angles to the right and up
 */
export function turnLamp(lamp, camera, centre, x, y) {
  const { right, up } = frameOf(camera);
  const middle = lamp.kind === "directional" ? [0, 0, 0] : centre;
  lamp.position = add(middle, turned(turned(subtract(lamp.position, middle), up, x), right, -y));
}

export class View {
  /**
   * @param {HTMLElement} canvas @param {HTMLElement} handles @param {{centre: Vector, radius: number}} body
   * @param {() => PageState} state @param {() => void} changed @param {(lamp: number) => void} chosen
   */
  constructor(canvas, handles, body, state, changed, chosen) {
    this.canvas = canvas;
    this.handles = handles;
    this.body = body;
    this.state = state;
    this.changed = changed;
    this.chosen = chosen;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    this.listen(canvas, (event) => this.dragCamera(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** @param {HTMLElement} element @param {(drag: {x: number, y: number, event: PointerEvent}) => void} drag */
  listen(element, drag) {
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      element.focus({ preventScroll: true });
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      event.preventDefault();
    });
    element.addEventListener("pointermove", (event) => {
      const before = this.pointers.get(event.pointerId);
      if (!before) return;
      const height = this.canvas.clientHeight || 1;
      drag({ x: (event.clientX - before.x) / height, y: (event.clientY - before.y) / height, event });
      this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      this.changed();
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(name, (event) => this.pointers.delete(/** @type {PointerEvent} */ (event).pointerId));
    }
  }

  /** One finger or the left button turns; two fingers pinch and move; other buttons and Shift move. */
  dragCamera(/** @type {{x: number, y: number, event: PointerEvent}} */ { x, y, event }) {
    const { camera } = this.state();
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (this.pointers.size === 2 && other) {
      const before = /** @type {{x: number, y: number}} */ (this.pointers.get(event.pointerId));
      const apart = Math.hypot(before.x - other.x, before.y - other.y);
      zoom(camera, apart / Math.max(Math.hypot(event.clientX - other.x, event.clientY - other.y), 1), this.body.radius);
      pan(camera, x / 2, y / 2);
    } else if (event.shiftKey || event.buttons & 6) pan(camera, x, y);
    else orbit(camera, 4 * x, 4 * y);
  }

  wheel(/** @type {WheelEvent} */ event) {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 20 : event.ctrlKey ? 8 : 1; // a pinch on a touch pad comes as small steps with Ctrl
    zoom(this.state().camera, Math.exp(clamp(event.deltaY * lines, -300, 300) * 1.5e-3), this.body.radius);
    this.changed();
  }

  key(/** @type {KeyboardEvent} */ event) {
    const { camera } = this.state();
    const [x, y] = arrow(event);
    if (x || y) {
      if (event.shiftKey) pan(camera, 0.05 * x, -0.05 * y);
      else orbit(camera, STEP * x, -STEP * y);
    } else if (event.key === "+" || event.key === "=") zoom(camera, 0.9, this.body.radius);
    else if (event.key === "-") zoom(camera, 1 / 0.9, this.body.radius);
    else if (event.key === "Home") this.canvas.dispatchEvent(new CustomEvent("home"));
    else return;
    event.preventDefault();
    this.changed();
  }

  // ---------------------------------------------------------------- lamps

  /** Put a handle for each lamp where it stands, or on the line to it. @param {number[]} matrix of the camera @param {number} selected */
  place(matrix, selected) {
    const { lamps } = this.state();
    while (this.handles.children.length > lamps.length) this.handles.lastElementChild?.remove();
    while (this.handles.children.length < lamps.length) this.addHandle(this.handles.children.length);
    const { origin } = this.state().camera;
    lamps.forEach((lamp, k) => {
      const from = lamp.kind === "directional" ? lamp.position : subtract(lamp.position, this.body.centre);
      const p = add(
        this.body.centre,
        times(unit(from), Math.min(HANDLE * this.body.radius, lamp.kind === "point" ? Math.hypot(...from) : Infinity)),
      );
      const [x, y, w] = [0, 1, 3].map(
        (row) => matrix[row] * p[0] + matrix[4 + row] * p[1] + matrix[8 + row] * p[2] + matrix[12 + row],
      );
      const handle = /** @type {HTMLElement} */ (this.handles.children[k]);
      handle.style.left = `clamp(18px, ${clamp(50 + (50 * x) / w, 0, 100)}%, 100% - 68px)`; // not behind the button of the controls
      handle.style.top = `clamp(18px, ${clamp(50 - (50 * y) / w, 0, 100)}%, 100% - 18px)`;
      handle.classList.toggle("behind", dot(subtract(p, this.body.centre), subtract(origin, this.body.centre)) < 0);
      handle.setAttribute("aria-pressed", String(k === selected));
    });
  }

  /** @param {number} k */
  addHandle(k) {
    const handle = document.createElement("button");
    handle.type = "button";
    handle.className = "lamp";
    handle.title = "Drag the lamp";
    handle.setAttribute("aria-label", `Lamp ${k + 1}. Arrow keys move it around the object.`);
    handle.addEventListener("focus", () => this.chosen(k));
    handle.addEventListener("keydown", (event) => {
      const [x, y] = arrow(event);
      if (!x && !y) return;
      event.preventDefault();
      this.turn(k, STEP * x, STEP * y);
      this.changed();
    });
    this.listen(handle, ({ x, y }) => this.turn(k, 4 * x, -4 * y));
    this.handles.append(handle);
  }

  /** @param {number} k @param {number} x @param {number} y */
  turn(k, x, y) {
    const { lamps, camera } = this.state();
    turnLamp(lamps[k], camera, this.body.centre, x, y);
  }
}

/** @param {KeyboardEvent} event @returns {[number, number]} to the right and up */
function arrow({ key }) {
  const ways = /** @type {Record<string, [number, number]>} */ ({
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, 1],
    ArrowDown: [0, -1],
  });
  return ways[key] ?? [0, 0];
}
