// The viewer of a report: draws the body of the page's data, and connects the controls of the page.

import { Vector3 } from "three";
import { decoded } from "./arrays.js";
import { Shape } from "./body.js";
import { css, GREY, linear, LOADS, SUPPORTS, viridis } from "./colours.js";
import { FIELDS, inUnit, principals, shown, unitOf, useUnits } from "./fields.js";
import { Look } from "./look.js";
import { Regions } from "./regions.js";
import { element, extent, meanSide, on, Stage } from "./stage.js";

const GLYPHS = 16; // along the body, at most

class Viewer extends Stage {
  start(body, arrays) {
    this.body = body;
    useUnits(body.units);
    const read = (number) => (number === null || number === undefined ? null : arrays[number]);
    const values = (number) => read(number)?.values;
    this.triangles = Uint32Array.from(values(body.triangles));
    this.error = read(body.error);
    this.inside = body.interior && {
      tetrahedra: Uint32Array.from(values(body.interior.tetrahedra)),
      interfaces: Uint32Array.from(values(body.interior.interfaces)),
      owners: Uint32Array.from(values(body.interior.owners)),
    };
    this.regions = new Regions(body.regions.names, body.regions.masks.map(values), body.regions.inner.map(values));
    this.fibres = Object.fromEntries(Object.entries(body.fibres.families).map(([name, n]) => [name, values(n)]));
    const fieldsOf = (part) => ({
      mesh: values(part.mesh), displacement: values(part.displacement),
      stress: read(part.stress), J: read(part.J), stretches: read(part.stretches),
    });
    this.results = body.results.map((result) => ({
      ...result,
      ...fieldsOf(result),
      interior: result.interior && fieldsOf(result.interior),
      crossing: values(result.crossing),
      deviation: read(result.deviation),
      fibres: Object.fromEntries(Object.entries(result.fibres).map(([name, n]) => [name, values(n)])),
      steps: [...result.steps.map((step) => ({ ...step, displacement: values(step.displacement) })), { load: result.load, last: true }],
    }));
    for (const result of this.results) result.steps.at(-1).displacement = result.displacement;
    this.#prepareBodies();
    this.#prepareControls();
    this.#chooseState(0);
    this.resetView();
  }

  get result() { return this.results[this.state]; }

  #prepareBodies() {
    this.prepareStage();
    const first = this.results[0].mesh, interior = this.inside;
    this.solid = new Shape(this.triangles, first, { interior });
    this.other = new Shape(this.triangles, first, { edges: this.solid.edges, interior });
    this.ghost = new Shape(this.triangles, first, { opacity: 0.22, edges: this.solid.edges });
    this.putBehind(this.ghost);
    this.side = meanSide(first, this.triangles);
    this.shapes = [this.solid, this.other, this.ghost];
    this.scene.add(...this.shapes.map((shape) => shape.group));
    const canvas = element("canvas");
    canvas.addEventListener("pointermove", (event) => this.#read(event));
    canvas.addEventListener("pointerleave", () => { element("reading").textContent = ""; });
  }

  #prepareControls() {
    const states = element("state");
    this.results.forEach((result, i) => states.add(new Option(result.title, i)));
    element("state-row").hidden = this.results.length < 2;
    const colours = element("colour");
    for (const field of FIELDS) {
      if (field.id === "error" && !this.error) continue;
      if (field.id === "deviation" && !this.results.some(({ deviation }) => deviation)) continue;
      if (field.regions && !this.body.regions.names.length) continue;
      colours.add(new Option(field.label, field.id));
    }
    const families = element("fibres");
    Object.keys(this.fibres).forEach((name) => families.add(new Option(name, name)));
    element("fibres-row").hidden = !Object.keys(this.fibres).length;
    on("state", "change", (input) => this.#chooseState(Number(input.value)));
    on("step", "input", () => this.update());
    on("shape", "input", () => this.update());
    on("scale", "input", () => this.update());
    on("layout", "change", () => { this.update(); this.frame(); this.resize(); });
    for (const id of ["colour", "fibres", "clip-axis", "clip-side", "symbols", "edges", "glyphs"]) on(id, "change", () => this.update());
    on("clip-place", "input", () => this.update());
    element("clip-note").hidden = Boolean(this.inside);
  }

  #chooseState(number) {
    this.state = number;
    const { steps } = this.result;
    const slider = element("step");
    slider.max = steps.length - 1;
    slider.value = steps.length - 1;
    slider.disabled = steps.length < 2;
    this.#supportsAndLoads();
    this.update();
  }

  #supportsAndLoads() {
    const list = element("symbol-list");
    list.replaceChildren();
    const numbers = { support: 0, load: 0 };
    for (const symbol of this.result.symbols) {
      const palette = symbol.kind === "support" ? SUPPORTS : LOADS;
      const item = document.createElement("li");
      const mark = document.createElement("span");
      mark.className = "mark";
      mark.style.background = palette[numbers[symbol.kind]++ % palette.length];
      item.append(mark, symbol.label);
      list.append(item);
    }
  }

  // Positions of the undeformed and the deformed body at the chosen step.
  #positions() {
    const { mesh, direction, steps } = this.result;
    const { displacement } = steps[Number(element("step").value)];
    const scale = Math.max(0, Number(element("scale").value) || 0);
    const pair = (given, move) => {
      const moved = given.map((x, i) => x + scale * move[i]);
      return direction === "forward" ? [given, moved] : [moved, given];
    };
    const { interior } = this.result;
    return { outer: pair(mesh, displacement), inner: interior ? pair(interior.mesh, interior.displacement) : null };
  }

  update() {
    const { result } = this;
    const step = result.steps[Number(element("step").value)];
    const layout = element("layout").value;
    const { outer: [undeformed, deformed], inner } = this.#positions();
    const share = layout === "beside" ? 1 : Number(element("shape").value) / 100;
    const between = undeformed.map((x, i) => x + share * (deformed[i] - x));
    this.solid.hidden = this.other.hidden = this.regions.hidden(this.triangles.length / 3);
    element("shape").disabled = layout === "beside";
    this.solid.place(between);
    this.other.group.visible = layout === "beside";
    this.ghost.group.visible = layout === "over";
    if (layout === "beside") this.other.place(undeformed);
    if (layout === "over") this.ghost.place(share > 0.5 ? undeformed : deformed);
    this.#separate(layout === "beside", undeformed, deformed);
    // Displacements inside are kept at the last step only.
    const bodies = inner && step.last ? [[this.solid, inner[0].map((x, i) => x + share * (inner[1][i] - x))], [this.other, inner[0]]] : [];
    const isShown = this.regions.off.size ? (row) => this.regions.isShown(row, true) : null;
    for (const shape of [this.solid, this.other]) shape.section.place(null, null);
    for (const [shape, points] of bodies) shape.section.place(points, this.cut, isShown);
    this.#colour(step, layout, bodies);
    this.applyCut();
    this.#extras(share, layout, step);
    const percent = Math.round(100 * share);
    element("shape-text").textContent = layout === "beside" ? "both" : percent === 0 ? result.undeformed : percent === 100 ? result.deformed : `${percent} %`;
    element("step-text").textContent = step.residual != null ? `position residual ${shown(step.residual, "m")}` : `load factor ${Number(step.load.toPrecision(4))}`;
    const caption = { beside: `left: ${result.undeformed}, right: ${result.deformed}`, over: `${result.undeformed} and ${result.deformed} in one place`, one: "one body" }[layout];
    element("caption").textContent = `${caption}; coloured by ${element("colour").selectedOptions[0].textContent}`;
    element("canvas").setAttribute("aria-label", `Body of ${this.body.name}: ${caption}. Arrow keys turn it, + and − zoom, 0 resets the view.`);
    this.draw();
  }

  #separate(apart, undeformed, deformed) {
    for (const shape of this.shapes) shape.group.position.set(0, 0, 0);
    this.setBox(undeformed, deformed);
    if (!apart) return;
    const right = this.right ?? new Vector3(1, 0, 0);
    const [left, most] = [extent(undeformed, right), extent(deformed, right)];
    this.gap = left[1] - most[0] + 0.12 * this.size; // the left body ends where the right one begins
    this.other.group.position.copy(right).multiplyScalar(-this.gap / 2);
    this.solid.group.position.copy(right).multiplyScalar(this.gap / 2);
  }

  #values(step) {
    const field = FIELDS.find(({ id }) => id === element("colour").value);
    if (field.id === "displacement") return [field, lengths(step.displacement)];
    if (!step.last && !field.regions && field.id !== "none") return [field, null];
    return [field, field.from?.(this.result, this) ?? null];
  }

  #colour(step, layout, bodies) {
    const [field, values] = this.#values(step);
    const colours = this.solid.geometry.attributes.color;
    const out = colours.array;
    const count = this.triangles.length / 3;
    const legend = element("legend");
    const notes = [];
    let paint = (array, at) => array.fill(GREY, at, at + 3);
    let inner = null;
    if (field.regions) {
      for (let c = 0; c < 3 * count; c++) this.regions.paint(out, 3 * c, Math.floor(c / 3), false);
      if (!legend.querySelector("[data-region]")) legend.replaceChildren(this.regions.list(() => this.update()));
      paint = (array, at, row) => this.regions.paint(array, at, row, true);
    } else if (values === null) {
      out.fill(GREY);
      legend.replaceChildren();
      if (field.id !== "none") notes.push(step.last ? "not known of this shape" : "values are kept at the last step only");
    } else {
      inner = this.#innerValues(field);
      const [low, high] = this.#range(field, values, inner);
      const factor = high > low ? 1 / (high - low) : 0;
      paint = (array, at, row, value) => {
        if (value === null) { array.fill(GREY, at, at + 3); return; }
        viridis((value - low) * factor, array, at);
        for (let i = 0; i < 3; i++) array[at + i] = linear(array[at + i]);
      };
      for (let c = 0; c < 3 * count; c++) paint(out, 3 * c, null, values[field.of === "points" ? this.triangles[c] : Math.floor(c / 3)]);
      this.#bar(legend, low, high, field);
      if (field.of !== "points" && field.id !== "error") notes.push(this.body.shell ? "at the faces of the shell" : field.id.startsWith("stretch") ? "in the middle of each cell" : "mean of each cell");
      if (this.cut && this.inside && !inner && step.last) notes.push("not known within the body");
    }
    for (const [shape, points] of bodies) {
      shape.section.colour(inner, field.of === "points", paint);
      shape.section.skin.visible = false;
      if (this.regions.off.size)
        shape.section.placeSkin(points, (row) => this.regions.isShown(row, true), field.of === "points" ? (array, at) => array.fill(GREY, at, at + 3) : (array, at, row) => paint(array, at, row, inner ? inner[row] : null));
    }
    if (this.cut && this.inside && !step.last) notes.push("the section is filled at the last step only");
    if (this.inside && this.cut && this.body.interior.joined) notes.push("the section joins cells to larger ones");
    if (this.result.crossing) {
      this.result.crossing.forEach((yes, t) => { if (yes) for (let k = 0; k < 3; k++) out.set([0.8, 0, 0], 9 * t + 3 * k); });
      notes.push("red: facets where the body passes through itself");
    }
    colours.needsUpdate = true;
    this.current = { field, values, inner };
    if (layout === "beside") {
      this.other.geometry.attributes.color.array.set(out);
      this.other.geometry.attributes.color.needsUpdate = true;
    }
    element("legend-note").textContent = notes.join("; ");
  }

  #innerValues(field) {
    const { interior } = this.result;
    if (!interior || field.id === "error" || field.id === "deviation") return null;
    return field.id === "displacement" ? lengths(interior.displacement) : field.from?.(interior, this) ?? null;
  }

  // Smallest and largest value, inside too where the section shows it.
  #range(field, values, inner) {
    const limits = range(field.id === "displacement" ? lengths(this.result.displacement) : values);
    if (!inner || !this.cut) return limits;
    const [low, high] = range(inner);
    return [Math.min(low, limits[0]), Math.max(high, limits[1])];
  }

  // A bar with its unit above, so that the numbers below are short.
  #bar(legend, low, high, field) {
    const bar = document.createElement("div");
    bar.className = "bar";
    const stops = [];
    const rgb = [0, 0, 0];
    for (let i = 0; i <= 12; i++) { viridis(i / 12, rgb, 0); stops.push(css(...rgb)); }
    bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const ends = document.createElement("div");
    ends.className = "ends";
    const [size, symbol] = unitOf(Math.max(Math.abs(low), Math.abs(high)), field.unit);
    for (const value of [low, (low + high) / 2, high]) {
      const text = document.createElement("span");
      text.textContent = inUnit(value, size);
      text.dataset.value = value;
      ends.append(text);
    }
    const unit = document.createElement("div");
    unit.className = "bar-unit";
    unit.textContent = symbol ? `in ${symbol}` : "";
    legend.replaceChildren(unit, bar, ends);
  }

  #extras(share, layout, step) {
    const family = element("fibres").value;
    const every = this.body.fibres.every;
    const length = 0.9 * Math.sqrt(every) * this.side;
    const shownFibres = Boolean(this.fibres[family]);
    const mix = () => {
      const a = this.fibres[family], b = this.result.fibres[family];
      const out = new Float32Array(a.length);
      for (let i = 0; i < a.length; i += 3) {
        const v = [0, 1, 2].map((k) => a[i + k] + share * (b[i + k] - a[i + k]));
        const size = Math.hypot(...v) || 1;
        for (let k = 0; k < 3; k++) out[i + k] = v[k] / size;
      }
      return out;
    };
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
    this.solid.drawFibres(shownFibres ? mix() : null, every, length);
    this.other.drawFibres(shownFibres && layout === "beside" ? this.fibres[family] : null, every, length);
    this.ghost.drawFibres(null, every, length);
    for (const shape of this.shapes) {
      shape.lines.visible = element("edges").checked;
      shape.edgeMaterial.color.set(dark ? 0xbbbbbb : 0x444444);
      shape.fibres.material.color.set(dark ? 0xffffff : 0x111111);
      shape.glyphs.clear();
    }
    this.#glyphs(this.solid, step);
    if (layout === "beside") this.#glyphs(this.other, step);
    const symbols = element("symbols").checked ? this.result.symbols : [];
    this.solid.drawSymbols(symbols, this.size, this.box, { loads: layout === "beside" || share > 0.5 });
    this.other.drawSymbols(layout === "beside" ? symbols : [], this.size, this.box, { loads: false });
    this.ghost.drawSymbols([], this.size, this.box);
  }

  // Displacements as arrows, or principal stresses as bars, at places that are evenly distributed.
  #glyphs(shape, step) {
    const kind = element("glyphs").value;
    const note = element("glyphs-note");
    note.textContent = { stress: "bars along the principal directions, orange in tension, blue in compression", displacement: "from the undeformed to the deformed body" }[kind] ?? "";
    if (kind === "none") return;
    if (kind === "stress" && !step.last) { note.textContent = "stresses are kept at the last step only"; return; }
    const length = (1.1 * this.size) / GLYPHS, taken = new Set(), { result } = this;
    const isFree = (p) => {
      const key = [p.x, p.y, p.z].map((x) => Math.floor(x / length)).join();
      if (taken.has(key)) return false;
      taken.add(key);
      return true;
    };
    const isKept = (p) => this.planes.every((plane) => plane.distanceToPoint(p) >= 0);
    const places = []; // [place, row, values], on the section first
    const middle = new Vector3();
    const { section } = shape;
    if (section.mesh.visible) section.rows.forEach((row, n) => { if (isFree(section.middle(n, middle))) places.push([middle.clone(), row, n, true]); });
    for (let t = 0; t < this.triangles.length / 3; t++) {
      if (shape.hidden?.[t]) continue;
      shape.centre(t, middle);
      if (isKept(middle) && isFree(middle)) places.push([middle.clone(), t, t, false]);
    }
    const sign = result.direction === "forward" ? 1 : -1;
    if (kind === "displacement") {
      const mean = (values, rows) => new Vector3(...[0, 1, 2].map((i) => (sign * rows.reduce((sum, row) => sum + values[3 * row + i], 0)) / rows.length));
      shape.drawVectors(places.map(([place, row, , isInner]) => {
        const rows = isInner ? this.inside.tetrahedra.slice(4 * row, 4 * row + 4) : this.triangles.slice(3 * row, 3 * row + 3);
        return [place, mean(isInner ? result.interior.displacement : step.displacement, [...rows])];
      }), 1.6 * length);
    } else {
      shape.drawCrosses(places.flatMap(([place, row, , isInner]) => {
        const { values } = (isInner ? result.interior : result).stress;
        return principals(values.slice(6 * row, 6 * row + 6)).map(({ value, way }) => [place, new Vector3(...way).normalize(), value]);
      }), 1.1 * length);
    }
  }

  // Says the value below the pointer.
  #read(event) {
    const now = performance.now();
    if (event.buttons || now - (this.lastReading ?? 0) < 60) return;
    this.lastReading = now;
    const hit = this.pick(event);
    if (!hit) { element("reading").textContent = ""; return; }
    const place = hit.place.toArray().map((x) => shown(x, "m"));
    const { field, values, inner } = this.current;
    const known = hit.isSection ? inner : values;
    const first = hit.isSection ? this.inside.tetrahedra[4 * hit.row] : this.triangles[3 * hit.row];
    const value = known ? `${field.label} ${shown(known[field.of === "points" ? first : hit.row], field.unit)} ` : "";
    const regions = this.regions.at(hit.row, hit.isSection);
    element("reading").textContent = `${value}at (${place.join(", ")})${regions.length ? `, ${regions.join(", ")}` : ""}`;
  }

  isHidden(row) { return this.solid.hidden?.[row]; }
}

function lengths(vectors) {
  const found = new Float32Array(vectors.length / 3);
  for (let i = 0; i < found.length; i++) found[i] = Math.hypot(vectors[3 * i], vectors[3 * i + 1], vectors[3 * i + 2]);
  return found;
}

function range(values) {
  let low = Infinity, high = -Infinity;
  for (const value of values) { if (value < low) low = value; if (value > high) high = value; }
  // Zero is known to the resolution of the arrays.
  return [Math.abs(low) < 3e-5 * Math.abs(high) ? 0 : low, Math.abs(high) < 3e-5 * Math.abs(low) ? 0 : high];
}

function unavailable(why) {
  document.documentElement.classList.add("no-viewer");
  element("no-viewer-why").textContent = why;
}

async function main() {
  if (!element("scene")) return;
  const test = document.createElement("canvas").getContext("webgl2");
  if (!test) return unavailable("This browser offers no WebGL 2.");
  test.getExtension("WEBGL_lose_context")?.loseContext();
  if (!("DecompressionStream" in window)) return unavailable("This browser cannot decompress the data of the page.");
  try {
    const body = JSON.parse(element("scene").textContent);
    const texts = [...document.querySelectorAll("script[data-array]")];
    const arrays = await Promise.all(texts.map((script, i) => decoded(body.arrays[i], script.textContent)));
    const page = body.kind === "job" ? new Look() : new Viewer();
    page.start(body, arrays);
    document.documentElement.dataset.viewer = "ready";
  } catch (error) {
    unavailable(`The interactive picture could not be started: ${error.message}`);
  }
}

main();
