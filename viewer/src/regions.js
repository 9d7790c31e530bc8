// Regions of a body: their colours, and which of them are drawn.

import { GREY, hex, linear, REGIONS } from "./colours.js";

const BITS = 16;

export class Regions {
  // `masks` and `inner` have the regions of each triangle and of each tetrahedron in bits.
  constructor(names, masks, inner = []) {
    Object.assign(this, { names, masks, inner, off: new Set() });
    this.colours = names.map((_, number) => hex(REGIONS[number % REGIONS.length]).map(linear));
  }

  #has(masks, number, row) { return Boolean(masks[Math.floor(number / BITS)]?.[row] & (1 << number % BITS)); }

  at(row, isInner = false) { return this.names.filter((_, number) => this.#has(isInner ? this.inner : this.masks, number, row)); }

  // Of regions that overlap the last is on top.
  paint(out, at, row, isInner) {
    const masks = isInner ? this.inner : this.masks;
    let colour = null;
    for (let number = 0; number < this.names.length; number++)
      if (!this.off.has(number) && this.#has(masks, number, row)) colour = this.colours[number];
    for (let k = 0; k < 3; k++) out[at + k] = colour ? colour[k] : GREY;
  }

  isShown(row, isInner = false) {
    for (const number of this.off) if (this.#has(isInner ? this.inner : this.masks, number, row)) return false;
    return true;
  }

  // Which of `count` triangles are left out, or null.
  hidden(count) { return this.off.size ? Uint8Array.from({ length: count }, (_, row) => !this.isShown(row)) : null; }

  // A list with a switch for each region.
  list(change, texts = this.names) {
    const list = document.createElement("ul");
    this.names.forEach((name, number) => {
      const item = document.createElement("li"), label = document.createElement("label");
      const mark = document.createElement("span"), box = document.createElement("input");
      box.type = "checkbox";
      box.checked = !this.off.has(number);
      box.dataset.region = name;
      box.addEventListener("change", () => { this.off[box.checked ? "delete" : "add"](number); change(); });
      mark.className = "mark";
      mark.style.background = REGIONS[number % REGIONS.length];
      label.append(box, " ", mark, texts[number]);
      item.append(label);
      list.append(item);
    });
    return list;
  }
}
