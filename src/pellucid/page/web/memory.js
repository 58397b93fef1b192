// What has changed since the last picture.

/** Remembers what a stage was made from. */
export class Memory {
  constructor() {
    /** @type {Map<string, string>} */
    this.keys = new Map();
  }

  /** @param {string} stage @param {unknown} inputs @returns {boolean} whether they differ from the last ones */
  changed(stage, inputs) {
    const key = JSON.stringify(inputs);
    if (this.keys.get(stage) === key) return false;
    this.keys.set(stage, key);
    return true;
  }
}
