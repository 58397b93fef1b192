// Begin: read the data of the file, build the engine, connect it with the controls.

import { makeBody } from "./body.js";
import { unpack } from "./data.js";
import { Device, Unsupported } from "./device.js";
import { Engine } from "./engine.js";
import { readTable } from "./medium.js";
import { element } from "./ui/controls.js";
import { asPng, download, settledPicture } from "./ui/keep.js";
import { Loop } from "./ui/loop.js";
import { MaterialControls } from "./ui/material.js";
import { Panel } from "./ui/panel.js";
import { connect } from "./ui/served.js";
import { engineState, fromLink, initialState, toLink } from "./ui/state.js";
import { View, fitted } from "./ui/view.js";

/** @import { Mesh, Texels } from "./atlas.js" */
/** @import { Planes } from "./data.js" */

const LINK_DELAY = 400; // milliseconds without a change after which the address follows

/** Buttons, and the fields of the state that they reset. @type {Record<string, (keyof import("./ui/state.js").PageState)[]>} */
const RESETS = {
  resetView: ["camera"],
  resetMaterial: ["material", "other", "share", "medium", "millimetres"],
  resetLight: ["lamps", "sky", "skyStops", "skyTurn", "floor"],
};

class Page {
  /** @param {any} head @param {Planes} planes @param {ImageBitmap | null} colours */
  constructor(head, planes, colours) {
    this.head = head;
    this.planes = planes;
    this.colours = colours;
    this.table = readTable(head.table, planes);
    this.canvas = /** @type {HTMLCanvasElement} */ (document.getElementById("view"));
    this.initial = initialState(head);
    this.state = fromLink(location.hash, this.initial, head);
    this.isBusy = false;
    this.device = new Device(this.canvas);
    this.body = makeBody(this.device, head.body, planes, colours);
    this.engine = this.newEngine();
    const state = () => this.state;
    const changed = () => this.changed();
    this.material = new MaterialControls(this.table, head.materials, state, changed);
    this.panel = new Panel(head, this.body, state, changed);
    const handles = /** @type {HTMLElement} */ (document.getElementById("handles"));
    this.view = new View(this.canvas, handles, this.body, state, changed, (lamp) => this.panel.choose(lamp));
    this.loop = new Loop(this.canvas, {
      now: (aspect) => ({ engine: this.engine, state: this.forEngine(), camera: this.cameraFor(aspect), mode: this.state.mode }),
      say: (text) => this.say(text),
      shown: () => this.view.place(this.engine.matrix, this.panel.lamp),
      failed: (error) => this.failed(error),
    });
    this.listen();
    this.showAll();
    this.begin();
  }

  newEngine() {
    return new Engine(this.device, this.body, this.table, this.head.constants, this.head.shifts, this.head.camera.up);
  }

  /** Make again all that lived on the device, where the browser has taken it away. */
  rebuild() {
    this.device = new Device(this.canvas);
    this.body = makeBody(this.device, this.head.body, this.planes, this.colours);
    this.engine = this.newEngine();
  }

  /** Say what went wrong, over the still picture of the file. @param {Error} error */
  failed(error) {
    console.error(error);
    complain(error);
    document.body.classList.remove("running");
  }

  /** Measure the device, and begin to draw: not in a test, which asks for its frames itself. */
  begin() {
    if (location.hash === "#test") this.loop.stop();
    else {
      this.loop.pace.measure(this.engine, this.forEngine());
      this.loop.start();
    }
    document.body.classList.add("running");
  }

  forEngine() {
    const [, ...rgb] = /** @type {string[]} */ (
      getComputedStyle(document.body).backgroundColor.match(/(\d+), (\d+), (\d+)/) ?? ["", "20", "20", "20"]
    );
    return engineState(
      this.state,
      this.head,
      rgb.map((value) => Number(value) / 255),
    );
  }

  /** @param {number} aspect of a picture */
  cameraFor(aspect) {
    return fitted(this.state.camera, this.head.aspect, aspect);
  }

  changed() {
    this.loop.changed();
    clearTimeout(this.linkTimer);
    this.linkTimer = setTimeout(() => this.writeLink(), LINK_DELAY);
  }

  /** @param {string} text */
  say(text) {
    /** @type {HTMLElement} */ (document.getElementById("status")).textContent = text;
  }

  showAll() {
    this.material.show();
    this.panel.show();
  }

  // ---------------------------------------------------------------- links, pictures, buttons

  writeLink() {
    const link = toLink(this.state, this.initial);
    if (link === (location.hash || "#") || location.hash === "#test") return;
    history.replaceState(null, "", link);
  }

  /** @param {Partial<import("./ui/state.js").PageState>} changes */
  set(changes) {
    Object.assign(this.state, structuredClone(changes));
    this.showAll();
    this.changed();
  }

  /** @param {(keyof import("./ui/state.js").PageState)[]} fields of the state */
  reset(fields) {
    this.set(Object.fromEntries(fields.map((field) => [field, this.initial[field]])));
  }

  async save() {
    const [width, height] = ["pictureWidth", "pictureHeight"].map((id) =>
      Math.min(Math.max(Number(element(id).value) || 16, 16), 8192),
    );
    const png = await this.apart(width, height, async (progress) => {
      await settledPicture(
        this.engine,
        { ...this.forEngine(), dots: false },
        this.cameraFor(width / height),
        width,
        height,
        this.loop.pace.rate * 0.1,
        progress,
      );
      return asPng(this.canvas);
    });
    download(png, `${this.head.name}.png`);
  }

  /**
   * Make a picture of another size while the page waits.
   * @template T
   * @param {number} width @param {number} height @param {(progress: (share: number) => void) => Promise<T>} make
   * @returns {Promise<T>}
   */
  async apart(width, height, make) {
    if (this.isBusy) throw new Error("Another picture is being made.");
    this.isBusy = true;
    this.loop.stop();
    const { device } = this;
    const { gl } = device;
    try {
      [this.canvas.width, this.canvas.height] = [width, height];
      if (gl.drawingBufferWidth !== width || gl.drawingBufferHeight !== height) throw new Unsupported();
      const result = await make((share) => this.say(`${width} × ${height}: ${Math.round(100 * share)} %`));
      if (gl.isContextLost() || this.device !== device) throw new Unsupported();
      return result;
    } catch (error) {
      if (!(error instanceof Unsupported)) throw error;
      throw new Error(`This device draws no picture of ${width} × ${height} pixels: choose a smaller one.`, { cause: error });
    } finally {
      this.isBusy = false;
      this.loop.start();
    }
  }

  /** @param {string} id @param {() => unknown} act */
  onClick(id, act) {
    element(id).addEventListener("click", async () => {
      try {
        await act();
      } catch (error) {
        complain(/** @type {Error} */ (error));
      }
    });
  }

  listen() {
    for (const [id, fields] of Object.entries(RESETS)) this.onClick(id, () => this.reset(fields));
    this.onClick("resetAll", () => this.set(this.initial));
    this.onClick("copyLink", () => this.copyLink());
    this.onClick("save", () => this.save());
    this.onClick("fold", () => {
      const folded = /** @type {HTMLElement} */ (document.getElementById("panel")).classList.toggle("folded");
      element("fold").setAttribute("aria-expanded", String(!folded));
    });
    element("panel").addEventListener("submit", (event) => event.preventDefault());
    this.canvas.addEventListener("home", () => this.reset(RESETS.resetView));
    window.addEventListener("hashchange", () => {
      if (location.hash !== toLink(this.state, this.initial)) this.set(fromLink(location.hash, this.initial, this.head));
    });
    matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => this.loop.changed());
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault(); // or it would not come back
      this.loop.stop();
      complain(new Error("The graphics driver has stopped; the page waits for it."));
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      try {
        this.rebuild();
        this.begin();
        complain(null);
      } catch (error) {
        this.failed(/** @type {Error} */ (error));
      }
    });
    if (this.head.served) connect(this);
    [element("pictureWidth").value, element("pictureHeight").value] = ["1600", "1200"];
  }

  async copyLink() {
    this.writeLink();
    try {
      await navigator.clipboard.writeText(location.href);
      this.say("The link is copied.");
    } catch {
      this.say("The address of this page is the link.");
    }
  }
}

/** Say what is wrong, or that it no longer is. @param {Error | null} error */
function complain(error) {
  const message = /** @type {HTMLElement} */ (document.getElementById("message"));
  message.hidden = error === null;
  message.textContent = error?.message ?? "";
}

/** @param {string} base64 of a JPEG */
function picture(base64) {
  const bytes = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/jpeg" }), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
}

async function begin() {
  const head = JSON.parse(document.getElementById("head")?.textContent ?? "");
  describe(head);
  const planes = await unpack(head.planes, document.getElementById("data")?.textContent ?? "");
  const colours = head.body.colours ? await picture(head.body.colours) : null;
  Object.assign(window, { pellucid: new Page(head, planes, colours) }); // for whoever opens the console
  document.body.dataset.ready = "yes";
}

/** Write who made the page and how. @param {any} head */
function describe({ credit, command, notes }) {
  const texts = { about: `Made with pellucid. To cite it: ${credit}`, command };
  for (const [id, text] of Object.entries(texts)) /** @type {HTMLElement} */ (document.getElementById(id)).textContent = text;
  const items = notes.map((/** @type {string} */ note) =>
    Object.assign(document.createElement("li"), { textContent: `Other than in the scene, ${note}.` }),
  );
  document.getElementById("notes")?.replaceChildren(...items);
}

begin().catch((error) => {
  console.error(error);
  const remedy = document.getElementById("still")
    ? "Below is a still picture; a browser of the last years on a device with graphics shows it moving."
    : "Start it as pellucid view --streamed: then Python draws, and this browser shows the pictures.";
  complain(error instanceof Unsupported ? new Error(`${error.message} ${remedy}`) : error);
  document.body.dataset.ready = "no";
});
