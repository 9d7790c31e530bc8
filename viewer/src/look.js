// A job before it runs: its body with regions, supports and loads; a click says where it is and how a job names it.

import { BufferAttribute, BufferGeometry, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { Shape } from "./body.js";
import { CHOSEN, GREY, hex, linear, LOADS, SUPPORTS } from "./colours.js";
import { Faces, quantity, rounded } from "./faces.js";
import { shown, useUnits } from "./fields.js";
import { Regions } from "./regions.js";
import { element, meanSide, on, Stage } from "./stage.js";

const CLICK = 4; // pixels that the pointer may move
const NAME = /^[A-Za-z_][\w-]*$/;

// Numbers of 64 bits, which the page has as four of 16.
function exact(values) { return new Float64Array(Uint16Array.from(values).buffer); }

export class Look extends Stage {
  start(body, arrays) {
    this.body = body;
    this.unit = body.unit;
    useUnits({ m: body.unit, ...body.units });
    const values = (number) => (number === null || number === undefined ? undefined : arrays[number].values);
    this.triangles = Uint32Array.from(values(body.triangles));
    this.points = values(body.points);
    this.facetOf = values(body.facet);
    this.faces = new Faces(exact(values(body.facets.vertices)), Uint32Array.from(values(body.facets.rows)), body.facets.sides);
    const { interior } = body;
    this.inside = interior && {
      points: values(interior.points),
      tetrahedra: Uint32Array.from(values(interior.tetrahedra)),
      interfaces: Uint32Array.from(values(interior.interfaces)),
      owners: Uint32Array.from(values(interior.owners)),
    };
    this.regions = new Regions(body.regions.names, body.regions.masks.map(values), body.regions.inner.map(values));
    this.added = []; // [section, name, rule]
    this.chosen = new Set();
    this.marks = [];
    this.prepareStage();
    this.solid = new Shape(this.triangles, this.points, { interior: this.inside });
    this.shapes = [this.solid];
    this.scene.add(this.solid.group);
    this.setBox(this.points);
    const radius = Math.max(0.1 * this.size, 3 * meanSide(this.points, this.triangles));
    this.radius = Number((radius / this.unit[0]).toPrecision(2));
    element("radius").value = this.radius;
    this.#prepareControls();
    this.resetView();
  }

  #prepareControls() {
    const change = () => this.update();
    for (const id of ["clip-axis", "clip-side", "symbols", "edges"]) on(id, "change", change);
    on("clip-place", "input", change);
    for (const id of ["tool", "angle", "radius"]) on(id, "input", () => this.#again());
    on("tool", "change", () => { if (element("tool").value !== "ruler") this.begin = null; });
    on("add", "click", () => this.#add());
    on("copy", "click", () => this.#copy());
    on("save", "click", () => this.#save());
    on("name", "input", () => this.#describe());
    const canvas = element("canvas");
    let from = null;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; });
    canvas.addEventListener("pointerup", (event) => {
      if (from && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < CLICK) this.#click(event);
    });
    const list = element("symbol-list"), numbers = { support: 0, load: 0 };
    for (const symbol of this.body.symbols) {
      const palette = symbol.kind === "support" ? SUPPORTS : LOADS;
      const item = document.createElement("li"), mark = document.createElement("span");
      mark.className = "mark";
      mark.style.background = palette[numbers[symbol.kind]++ % palette.length];
      item.append(mark, symbol.label);
      list.append(item);
    }
    const { names, texts } = this.body.regions;
    element("legend").replaceChildren(names.length ? this.regions.list(change, texts) : "The mesh has no regions yet.");
    this.#showAdded();
  }

  update() {
    const { solid, regions } = this;
    solid.hidden = regions.hidden(this.triangles.length / 3);
    solid.place(this.points);
    const isShown = regions.off.size ? (row) => regions.isShown(row, true) : null;
    const paint = (out, at, row) => regions.paint(out, at, row, true);
    solid.section.place(this.inside?.points, this.cut, isShown);
    solid.section.colour(null, false, paint);
    solid.section.skin.visible = false;
    if (this.inside && isShown) solid.section.placeSkin(this.inside.points, isShown, paint);
    this.#colour();
    this.applyCut();
    solid.lines.visible = element("edges").checked;
    const dark = getComputedStyle(document.documentElement).colorScheme.includes("dark");
    solid.edgeMaterial.color.set(dark ? 0xbbbbbb : 0x444444);
    solid.drawSymbols(element("symbols").checked ? this.body.symbols : [], this.size, this.box);
    element("canvas").setAttribute("aria-label", `Body of ${this.body.name}. Click it to read a place. Arrow keys turn it, + and − zoom, 0 resets the view.`);
    this.draw();
  }

  #colour() {
    const { array } = this.solid.geometry.attributes.color;
    const mark = hex(CHOSEN).map(linear);
    array.fill(GREY);
    for (let c = 0; c < this.triangles.length; c++) {
      const row = Math.floor(c / 3);
      if (this.chosen.has(this.facetOf[row])) array.set(mark, 3 * c);
      else this.regions.paint(array, 3 * c, row, false);
    }
    this.solid.geometry.attributes.color.needsUpdate = true;
  }

  #click(event) {
    const hit = this.pick(event);
    if (!hit) return;
    if (element("tool").value === "ruler") this.#measure(hit.place);
    else this.choose(hit.isSection ? null : this.facetOf[hit.row], hit.place, this.regions.at(hit.row, hit.isSection));
  }

  // Describes a place on a facet, or inside the body where there is none.
  choose(facet, place, regions) {
    this.hit = { facet, place, regions };
    this.begin = null;
    this.#again();
  }

  #again() {
    const tool = element("tool").value;
    element("angle-row").hidden = tool !== "face";
    element("radius-row").hidden = tool !== "disc";
    if (!this.hit || tool === "ruler") return;
    const { facet, place } = this.hit;
    this.rule = null;
    if (facet !== null && tool !== "point") {
      const { faces, size, unit } = this;
      if (tool === "side") this.rule = faces.side(facet, size, unit);
      if (tool === "disc") this.rule = faces.disc(facet, place, Number(element("radius").value) || this.radius, size, unit);
      if (tool === "face") this.rule = faces.smooth(facet, Math.min(180, Math.max(0.1, Number(element("angle").value) || 30)), unit);
    }
    this.chosen = new Set(this.rule?.facets ?? []);
    this.#mark([place]);
    this.#describe();
    this.#colour();
    this.draw();
  }

  #point(place) { return place.toArray().map((x) => quantity(rounded(x / this.unit[0], this.size / this.unit[0]), this.unit[1])).join(", "); }

  #describe() {
    if (!this.hit) return;
    const { facet, place, regions } = this.hit;
    const labels = regions.filter((name) => this.body.regions.labels.includes(name));
    const others = regions.filter((name) => !labels.includes(name));
    const rows = [["place", `(${this.#point(place)})`]];
    if (facet !== null) rows.push(["outer normal", `(${this.faces.normal(facet).toArray().map((x) => Number(x.toFixed(3)) || 0).join(", ")})`]);
    else rows.push(["inside", "on the section"]);
    rows.push(["label", labels.join(", ") || "none"], ["regions", others.join(", ") || "none"]);
    if (facet !== null) rows.push(["nearest node", `(${this.#point(this.faces.nearestVertex(place))})`]);
    if (this.rule) rows.push(["facets", `${this.rule.facets.length}${this.body.decimated ? " of the triangles that are drawn; the mesh has more" : ""}`]);
    element("finding").replaceChildren(...rows.flatMap(([name, text]) => {
      const [head, value] = [document.createElement("dt"), document.createElement("dd")];
      [head.textContent, value.textContent] = [name, text];
      return [head, value];
    }));
    const name = element("name").value.trim() || "part";
    const isPoint = !this.rule && element("tool").value === "point" && Boolean(this.body.job.save);
    this.at = `at: [${this.#point(place)}]`;
    element("line").textContent = this.rule ? `regions: {${name}: ${this.rule.text}}` : this.at;
    const fault = !NAME.test(name) ? "Names have letters, digits, _ and -."
      : this.#isTaken(name) ? `There is a ${this.rule ? "region" : "quantity"} '${name}'.`
      : this.rule?.facets.length === 0 ? "No facet has all its vertices there: choose a larger one." : "";
    element("name-note").textContent = this.rule || isPoint ? fault : "";
    element("add").disabled = !(this.rule || isPoint) || Boolean(fault);
    element("copy").disabled = false;
  }

  #isTaken(name) {
    const section = this.rule ? "regions" : "quantities";
    const taken = this.rule ? ["boundary", ...this.body.regions.taken] : this.body.quantities;
    return taken.includes(name) || this.added.some(([other, text]) => other === section && text === name);
  }

  #measure(place) {
    if (!this.begin) { this.begin = place; this.#mark([place]); element("line").textContent = ""; element("reading").textContent = "Click the other end."; return; }
    const [a, b] = [this.begin, place];
    this.begin = null;
    this.#mark([a, b]);
    const parts = b.clone().sub(a).toArray().map((x) => shown(x, "m")).join(", ");
    element("reading").textContent = `${shown(a.distanceTo(b), "m")} between the points; along x, y, z: ${parts}`;
  }

  #mark(places) {
    for (const mark of this.marks) { this.scene.remove(mark); mark.geometry.dispose(); }
    element("reading").textContent = "";
    this.marks = places.map((place) => {
      const mark = new Mesh(new SphereGeometry(0.006 * this.size, 16, 12), new MeshBasicMaterial({ color: 0x000000 }));
      mark.position.copy(place);
      return mark;
    });
    if (places.length > 1) {
      const geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(places.flatMap((place) => place.toArray())), 3));
      this.marks.push(new Line(geometry, new LineBasicMaterial({ color: 0xd55e00, depthTest: false })));
    }
    if (this.marks.length) this.scene.add(...this.marks);
    this.draw();
  }

  #add() {
    const name = element("name").value.trim() || "part";
    this.added.push(this.rule ? ["regions", name, this.rule.text] : ["quantities", name, `{of: displacement, ${this.at}}`]);
    element("name").value = "";
    this.#showAdded();
    this.#describe();
  }

  #showAdded() {
    element("added").replaceChildren(...this.added.map(([, name, rule], i) => {
      const item = document.createElement("li"), remove = document.createElement("button");
      remove.type = "button";
      remove.textContent = "×";
      remove.setAttribute("aria-label", `Leave out ${name}`);
      remove.addEventListener("click", () => { this.added.splice(i, 1); this.#showAdded(); });
      item.append(`${name}: ${rule} `, remove);
      return item;
    }));
    element("save").disabled = !this.added.length;
    element("saved").textContent = this.job();
  }

  // The text of the job with the regions that were added.
  job() {
    const { before, after, indent, style } = this.body.job;
    const entries = this.added.filter(([section]) => section === "regions").map(([, name, rule]) => `${name}: ${rule}`);
    if (!entries.length) return "";
    if (style === "flow") return `${before}${entries.join(", ")}${after.trimStart().startsWith("}") ? "" : ", "}${after}`;
    return before + entries.map((entry) => `${indent}${entry}\n`).join("") + after;
  }

  #copy() {
    const text = element("line").textContent;
    navigator.clipboard?.writeText(text).catch(() => {});
    window.getSelection().selectAllChildren(element("line"));
  }

  // Sends what was added to the server of this page, which writes it into the job.
  async #write() {
    const entries = this.added.map(([section, name, rule]) => [section, section === "regions" ? `${name}: ${rule}` : `{name: ${name}, ${rule.slice(1)}`]);
    element("save").disabled = true;
    let message = "The server does not answer: is 'hpcinv show --edit' still running?", written = false;
    try {
      const answer = await fetch(this.body.job.save, { method: "POST", body: JSON.stringify({ entries }) });
      written = answer.ok;
      message = (await answer.json()).message;
    } catch { /* the message says it */ }
    if (written) {
      for (const [section, name] of this.added) (section === "regions" ? this.body.regions.taken : this.body.quantities).push(name);
      this.added = [];
      this.#showAdded();
      this.#describe();
    }
    element("save").disabled = !this.added.length;
    element("written").textContent = message;
  }

  #save() {
    if (this.body.job.save) { this.#write(); return; }
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([this.job()], { type: "text/yaml" }));
    link.download = this.body.job.file;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  isHidden(row) { return this.solid.hidden?.[row]; }
}
