// The controls of the material: every field shows the same medium, whichever of them it was set by.

import { diffuseDistance, fromReflectance, Medium } from "../medium.js";
import { clamp } from "../vectors.js";
import { choices, element, fromHex, toHex } from "./controls.js";

/** @import { Coefficients, MediumTable } from "../medium.js" */
/** @import { PageState } from "./state.js" */
/** @import { Vector } from "../vectors.js" */

const ROWS = /** @type {Record<string, string>} */ ({
  reflectance: "reflectance",
  distance: "mean free path [mm]",
  scattering: "scattering [1/mm]",
  absorption: "absorption [1/mm]",
});
const [DARKEST, LIGHTEST] = [1e-4, 0.998];

/**
 * Mix the coefficients of two media.
 * @param {Coefficients} one @param {Coefficients} other @param {number} share of the other
 * @returns {Coefficients}
 */
function blend(one, other, share) {
  const mix = (/** @type {Vector} */ a, /** @type {Vector} */ b) => a.map((x, k) => (1 - share) * x + share * b[k]);
  return {
    scattering: mix(one.scattering, other.scattering),
    absorption: mix(one.absorption, other.absorption),
    eta: (1 - share) * one.eta + share * other.eta,
    g: (1 - share) * one.g + share * other.g,
  };
}

export class MaterialControls {
  /** @param {MediumTable} table @param {Record<string, Coefficients>} materials @param {() => PageState} state @param {() => void} changed */
  constructor(table, materials, state, changed) {
    this.table = table;
    this.materials = materials;
    this.state = state;
    this.changed = changed;
    const names = Object.keys(materials);
    choices("material", [["", "as set below"], ...names.map((name) => [name, name])]);
    choices("other", [["", "nothing"], ...names.map((name) => [name, name])]);
    this.fields = Object.fromEntries(Object.keys(ROWS).map((row) => [row, this.addRow(row)]));
    for (const id of ["material", "other", "share"]) element(id).addEventListener("input", () => this.fromPreset());
    for (const id of ["eta", "g"])
      element(id).addEventListener("input", () => this.set({ ...state().medium, [id]: Number(element(id).value) }));
    element("colour").addEventListener("input", () => this.fromReflectance(fromHex(element("colour").value), this.distance()));
  }

  /** @param {string} row @returns {HTMLInputElement[]} fields for red, green and blue */
  addRow(row) {
    const line = /** @type {HTMLTableSectionElement} */ (
      document.getElementById(row === "reflectance" || row === "distance" ? "reflectances" : "coefficients")
    ).insertRow();
    const title = document.createElement("th");
    title.scope = "row";
    title.textContent = ROWS[row];
    line.append(title);
    return ["red", "green", "blue"].map((channel) => {
      const field = document.createElement("input");
      Object.assign(field, { type: "number", step: "any", min: "0" });
      field.setAttribute("aria-label", `${ROWS[row]}, ${channel}`);
      field.addEventListener("change", () => this.fromField(row));
      line.insertCell().append(field);
      return field;
    });
  }

  /** @param {string} row @returns {Vector} */
  read(row) {
    return this.fields[row].map((field) => Math.max(Number(field.value) || 0, 0));
  }

  /** @param {string} row that was changed */
  fromField(row) {
    const { medium } = this.state();
    if (row === "scattering") this.set({ ...medium, scattering: this.read(row).map((x) => Math.max(x, 1e-6)) });
    else if (row === "absorption") this.set({ ...medium, absorption: this.read(row) });
    else this.fromReflectance(this.read("reflectance"), this.read("distance"));
  }

  /** @param {Vector} reflectance @param {Vector} distance diffuse mean free paths [mm] */
  fromReflectance(reflectance, distance) {
    const bounded = reflectance.map((x) => clamp(x, DARKEST, LIGHTEST));
    this.set(
      fromReflectance(
        this.table,
        bounded,
        distance.map((x) => clamp(x, 1e-3, 1e4)),
        this.state().medium.eta,
        this.state().medium.g,
      ),
    );
  }

  /** Diffuse mean free paths of now [mm]; without absorption they have no end. */
  distance() {
    return diffuseDistance(this.table, this.state().medium).map((x) => Math.min(x, 1e4));
  }

  fromPreset() {
    const state = this.state();
    state.material = element("material").value;
    state.other = element("other").value;
    state.share = Number(element("share").value);
    const base = this.materials[state.material] ?? state.medium;
    state.medium = state.other ? blend(base, this.materials[state.other], state.share) : structuredClone(base);
    this.show();
    this.changed();
  }

  /** @param {Coefficients} medium */
  set(medium) {
    Object.assign(this.state(), { medium, material: "", other: "" });
    this.show();
    this.changed();
  }

  /** Write the medium into all fields. */
  show() {
    const { medium, material, other, share } = this.state();
    element("material").value = material;
    element("other").value = other;
    element("share").value = String(share);
    element("eta").value = String(medium.eta);
    element("g").value = String(medium.g);
    /** @type {HTMLElement} */ (document.getElementById("shareRow")).hidden = !other;
    const { reflectance } = new Medium(this.table, medium, 1);
    const values = { reflectance, distance: this.distance(), scattering: medium.scattering, absorption: medium.absorption };
    for (const [row, numbers] of Object.entries(values))
      this.fields[row].forEach((field, k) => (field.value = String(Number(numbers[k].toPrecision(3)))));
    element("colour").value = toHex(reflectance);
  }
}
