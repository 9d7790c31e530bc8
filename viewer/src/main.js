// The viewer of a report: draws the body of the page's data, and connects the controls of the page.

import { AmbientLight, Box3, DirectionalLight, OrthographicCamera, Plane, Raycaster, Scene, Spherical, Quaternion, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { decoded } from "./arrays.js";
import { Shape } from "./body.js";
import { css, LOADS, REGIONS, SUPPORTS, viridis } from "./colours.js";
import { FIELDS, shown } from "./fields.js";

const element = (id) => document.getElementById(id);
const hex = (text) => [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);
const linear = (c) => (c < 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

class Viewer {
  async start() {
    this.body = JSON.parse(element("scene").textContent);
    const specs = this.body.arrays;
    const texts = [...document.querySelectorAll("script[data-array]")];
    const arrays = await Promise.all(texts.map((script, i) => decoded(specs[i], script.textContent)));
    const read = (number) => (number === null || number === undefined ? null : arrays[number]);
    this.triangles = Uint32Array.from(read(this.body.triangles).values);
    this.error = read(this.body.error);
    this.masks = this.body.regions.masks.map((number) => read(number).values);
    this.fibres = Object.fromEntries(Object.entries(this.body.fibres.families).map(([name, n]) => [name, read(n).values]));
    this.results = this.body.results.map((result) => ({
      ...result,
      mesh: read(result.mesh).values,
      displacement: read(result.displacement).values,
      stress: read(result.stress),
      J: read(result.J),
      stretches: read(result.stretches),
      crossing: read(result.crossing)?.values,
      deviation: read(result.deviation),
      fibres: Object.fromEntries(Object.entries(result.fibres).map(([name, n]) => [name, read(n).values])),
      steps: [...result.steps.map((step) => ({ ...step, displacement: read(step.displacement).values })), { load: result.load, last: true }],
    }));
    for (const result of this.results) result.steps.at(-1).displacement = result.displacement;
    this.#prepareScene();
    this.#prepareControls();
    this.#chooseState(0);
    this.resetView();
  }

  get result() { return this.results[this.state]; }

  #prepareScene() {
    const canvas = element("canvas");
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.scene = new Scene();
    this.camera = new OrthographicCamera(-1, 1, 1, -1, -1, 1);
    this.camera.up.fromArray(this.body.up);
    this.lamp = new DirectionalLight(0xffffff, 2.0);
    this.scene.add(new AmbientLight(0xffffff, 1.7), this.lamp);
    this.clip = new Plane();
    const first = this.results[0].mesh;
    this.solid = new Shape(this.triangles, first);
    this.other = new Shape(this.triangles, first, { edges: this.solid.edges });
    this.ghost = new Shape(this.triangles, first, { opacity: 0.22, edges: this.solid.edges });
    this.side = meanSide(first, this.triangles);
    this.shapes = [this.solid, this.other, this.ghost];
    this.scene.add(...this.shapes.map((shape) => shape.group));
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.enableDamping = false;
    this.orbit.addEventListener("change", () => this.#draw());
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("keydown", (event) => this.#key(event));
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
      colours.add(new Option(field.label + (field.unit ? ` (${field.unit})` : ""), field.id));
    }
    const families = element("fibres");
    Object.keys(this.fibres).forEach((name) => families.add(new Option(name, name)));
    element("fibres-row").hidden = !Object.keys(this.fibres).length;
    const on = (id, event, act) => element(id).addEventListener(event, () => act(element(id)));
    on("state", "change", (input) => this.#chooseState(Number(input.value)));
    on("step", "input", () => this.update());
    on("shape", "input", () => this.update());
    on("scale", "input", () => this.update());
    on("layout", "change", () => { this.update(); this.#frame(); this.#resize(); });
    for (const id of ["colour", "fibres", "clip-axis", "clip-side", "symbols", "edges"]) on(id, "change", () => this.update());
    on("clip-place", "input", () => this.update());
    on("reset", "click", () => this.resetView());
    document.querySelectorAll("[data-view]").forEach((button) =>
      button.addEventListener("click", () => this.resetView(button.dataset.view)));
    document.addEventListener("themechange", () => this.update());
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
    const found = new Float32Array(mesh.length);
    for (let i = 0; i < mesh.length; i++) found[i] = mesh[i] + scale * displacement[i];
    return direction === "forward" ? [mesh, found] : [found, mesh];
  }

  update() {
    const { result } = this;
    const step = result.steps[Number(element("step").value)];
    const layout = element("layout").value;
    const [undeformed, deformed] = this.#positions();
    const share = layout === "beside" ? 1 : Number(element("shape").value) / 100;
    const between = new Float32Array(deformed.length);
    for (let i = 0; i < between.length; i++) between[i] = undeformed[i] + share * (deformed[i] - undeformed[i]);
    element("shape").disabled = layout === "beside";
    this.solid.place(between);
    this.other.group.visible = layout === "beside";
    this.ghost.group.visible = layout === "over";
    if (layout === "beside") this.other.place(undeformed);
    if (layout === "over") this.ghost.place(share > 0.5 ? undeformed : deformed);
    this.#separate(layout === "beside", undeformed, deformed);
    this.#colour(step, layout);
    this.#clip();
    this.#extras(share, layout);
    const percent = Math.round(100 * share);
    element("shape-text").textContent = layout === "beside" ? "both" : percent === 0 ? result.undeformed : percent === 100 ? result.deformed : `${percent} %`;
    element("step-text").textContent = step.residual != null ? `position residual ${shown(step.residual, "m")}` : `load factor ${Number(step.load.toPrecision(4))}`;
    const caption = { beside: `left: ${result.undeformed}, right: ${result.deformed}`, over: `${result.undeformed} and ${result.deformed} in one place`, one: "one body" }[layout];
    element("caption").textContent = `${caption}; coloured by ${element("colour").selectedOptions[0].textContent}`;
    element("canvas").setAttribute("aria-label", `Body of ${this.body.name}: ${caption}. Arrow keys turn it, + and − zoom, 0 resets the view.`);
    this.#draw();
  }

  #separate(apart, undeformed, deformed) {
    for (const shape of this.shapes) shape.group.position.set(0, 0, 0);
    const box = new Box3().setFromArray(undeformed).union(new Box3().setFromArray(deformed));
    this.box = box;
    this.size = box.getSize(new Vector3()).length();
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

  #colour(step, layout) {
    const [field, values] = this.#values(step);
    const colours = this.solid.geometry.attributes.color;
    const out = colours.array;
    const count = this.triangles.length / 3;
    const legend = element("legend");
    const notes = [];
    if (field.regions) this.#colourRegions(out, legend);
    else if (values === null) {
      out.fill(linear(0.8));
      legend.replaceChildren();
      if (field.id !== "none") notes.push(step.last ? "not known of this shape" : "values are kept at the last step only");
    } else {
      const [low, high] = range(field.id === "displacement" ? lengths(this.result.displacement) : values);
      const factor = high > low ? 1 / (high - low) : 0;
      for (let t = 0; t < count; t++)
        for (let k = 0; k < 3; k++) {
          const value = values[field.of === "points" ? this.triangles[3 * t + k] : t];
          const at = 9 * t + 3 * k;
          viridis((value - low) * factor, out, at);
          for (let i = 0; i < 3; i++) out[at + i] = linear(out[at + i]);
        }
      this.#bar(legend, low, high, field);
      if (field.of !== "points" && field.id !== "error") notes.push(field.id.startsWith("stretch") ? "in the middle of each cell" : "mean of each cell");
    }
    if (this.result.crossing) {
      this.result.crossing.forEach((yes, t) => { if (yes) for (let k = 0; k < 3; k++) out.set([0.8, 0, 0], 9 * t + 3 * k); });
      notes.push("red: facets where the body passes through itself");
    }
    colours.needsUpdate = true;
    this.current = { field, values };
    if (layout === "beside") {
      this.other.geometry.attributes.color.array.set(out);
      this.other.geometry.attributes.color.needsUpdate = true;
    }
    element("legend-note").textContent = notes.join("; ");
  }

  #colourRegions(out, legend) {
    out.fill(linear(0.8));
    const list = document.createElement("ul");
    this.body.regions.names.forEach((name, number) => {
      const colour = REGIONS[number % REGIONS.length];
      const rgb = hex(colour).map(linear);
      const mask = this.masks[Math.floor(number / 16)], bit = 1 << number % 16;
      mask.forEach((bits, t) => { if (bits & bit) for (let k = 0; k < 3; k++) out.set(rgb, 9 * t + 3 * k); });
      const item = document.createElement("li");
      const mark = document.createElement("span");
      mark.className = "mark";
      mark.style.background = colour;
      item.append(mark, name);
      list.append(item);
    });
    legend.replaceChildren(list);
  }

  #bar(legend, low, high, field) {
    const bar = document.createElement("div");
    bar.className = "bar";
    const stops = [];
    const rgb = [0, 0, 0];
    for (let i = 0; i <= 12; i++) { viridis(i / 12, rgb, 0); stops.push(css(...rgb)); }
    bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const ends = document.createElement("div");
    ends.className = "ends";
    for (const value of [low, (low + high) / 2, high]) {
      const text = document.createElement("span");
      text.textContent = shown(value, field.unit);
      text.dataset.value = value;
      ends.append(text);
    }
    legend.replaceChildren(bar, ends);
  }

  #clip() {
    const axis = element("clip-axis").value;
    element("clip-place").disabled = element("clip-side").disabled = axis === "none";
    let planes = [];
    if (axis !== "none") {
      const k = "xyz".indexOf(axis);
      const sign = element("clip-side").checked ? 1 : -1;
      const place = this.box.min.getComponent(k) + (Number(element("clip-place").value) / 100) * (this.box.max.getComponent(k) - this.box.min.getComponent(k));
      this.clip.normal.set(0, 0, 0).setComponent(k, sign);
      this.clip.constant = -sign * place;
      planes = [this.clip];
      element("clip-text").textContent = `${axis} = ${shown(Math.abs(place) < 1e-6 * this.size ? 0 : place, "m")}`;
    } else element("clip-text").textContent = "whole body";
    this.planes = planes;
    for (const shape of this.shapes) {
      // Planes are in space: a body that is moved aside takes its own with it.
      const own = planes.map((plane) => plane.clone().translate(shape.group.position));
      for (const part of [shape.material, shape.edgeMaterial, shape.fibres.material]) part.clippingPlanes = own;
    }
  }

  #extras(share, layout) {
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
    }
    const symbols = element("symbols").checked ? this.result.symbols : [];
    this.solid.drawSymbols(symbols, this.size, this.box, this.planes, { loads: layout === "beside" || share > 0.5 });
    this.other.drawSymbols(layout === "beside" ? symbols : [], this.size, this.box, [], { loads: false });
    this.ghost.drawSymbols([], this.size, this.box, []);
  }

  // Looks at the body from in front and above, or along an axis.
  resetView(axis = "oblique") {
    const up = new Vector3().fromArray(this.body.up);
    const level = [0, 1, 2].map((k) => new Vector3().setComponent(k, 1)).filter((v) => Math.abs(v.dot(up)) < 0.9);
    const size = this.box.getSize(new Vector3());
    const [wide, deep] = level.sort((a, b) => Math.abs(b.dot(size)) - Math.abs(a.dot(size)));
    const front = up.clone().cross(wide);
    if (front.dot(deep) < 0 && axis === "oblique") front.copy(up.clone().cross(wide));
    const from = {
      oblique: wide.clone().multiplyScalar(-0.45).sub(front).addScaledVector(up, 0.4),
      x: new Vector3(1, 0, 0), y: new Vector3(0, 1, 0), z: new Vector3(0, 0, 1),
    }[axis].normalize();
    this.camera.up.copy(Math.abs(from.dot(up)) > 0.99 ? wide : up);
    this.right = this.camera.up.clone().cross(from).normalize();
    this.orbit.target.copy(this.box.getCenter(new Vector3()));
    this.camera.position.copy(this.orbit.target).addScaledVector(from, 4 * this.size);
    this.camera.zoom = 1;
    this.update();
    this.orbit.update();
    this.#frame();
    this.#resize();
  }

  // Lets all bodies fill the picture in the present direction of view.
  #frame() {
    this.camera.updateMatrixWorld();
    const [right, up, back] = [0, 1, 2].map((k) => new Vector3().setFromMatrixColumn(this.camera.matrixWorld, k));
    const found = [right, up].map((way) => {
      let low = Infinity, high = -Infinity;
      for (const shape of this.shapes.filter((one) => one.group.visible)) {
        const [least, most] = extent(shape.points, way), aside = shape.group.position.dot(way);
        low = Math.min(low, least + aside);
        high = Math.max(high, most + aside);
      }
      return [low, high];
    });
    [this.wide, this.high] = found.map(([low, high]) => high - low);
    const target = back.clone().multiplyScalar(this.orbit.target.dot(back));
    [right, up].forEach((way, k) => target.addScaledVector(way, (found[k][0] + found[k][1]) / 2));
    this.camera.position.add(target.clone().sub(this.orbit.target));
    this.orbit.target.copy(target);
    this.camera.updateMatrixWorld();
  }

  #resize() {
    const canvas = element("canvas");
    const { clientWidth, clientHeight } = canvas;
    if (!clientWidth || !clientHeight || !this.wide) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    const aspect = clientWidth / clientHeight;
    const margin = 0.16 * this.size; // for symbols
    const high = Math.max(this.high + margin, (this.wide + margin) / aspect);
    Object.assign(this.camera, { left: (-high * aspect) / 2, right: (high * aspect) / 2, top: high / 2, bottom: -high / 2, near: 0, far: 8 * this.size + (this.gap ?? 0) });
    this.camera.updateProjectionMatrix();
    this.#draw();
  }

  #key(event) {
    const turn = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (turn) {
      const upright = new Quaternion().setFromUnitVectors(this.camera.up, new Vector3(0, 1, 0));
      const offset = this.camera.position.clone().sub(this.orbit.target).applyQuaternion(upright);
      const place = new Spherical().setFromVector3(offset);
      place.theta += 0.15 * turn[0];
      place.phi += 0.15 * turn[1];
      place.makeSafe();
      offset.setFromSpherical(place).applyQuaternion(upright.invert());
      this.camera.position.copy(this.orbit.target).add(offset);
      this.camera.lookAt(this.orbit.target);
    } else if (event.key === "+" || event.key === "=") this.camera.zoom *= 1.15;
    else if (event.key === "-") this.camera.zoom /= 1.15;
    else if (event.key === "0") this.resetView();
    else return;
    event.preventDefault();
    this.camera.updateProjectionMatrix();
    this.orbit.update();
    this.#draw();
  }

  // Tells the value below the pointer.
  #read(event) {
    const now = performance.now();
    if (event.buttons || now - (this.lastReading ?? 0) < 60) return;
    this.lastReading = now;
    const { left, top, width: w, height: h } = element("canvas").getBoundingClientRect();
    const at = new Vector2((2 * (event.clientX - left)) / w - 1, 1 - (2 * (event.clientY - top)) / h);
    this.raycaster ??= new Raycaster();
    this.raycaster.setFromCamera(at, this.camera);
    const bodies = [this.solid, this.other].filter((shape) => shape.group.visible);
    for (const shape of bodies) shape.geometry.boundingSphere = null;
    const kept = (hit) => (this.planes ?? []).every((p) => p.distanceToPoint(hit.point.clone().sub(hit.object.parent.position)) >= 0);
    const hit = this.raycaster.intersectObjects(bodies.map((shape) => shape.mesh)).find(kept);
    if (!hit) { element("reading").textContent = ""; return; }
    const place = hit.point.clone().sub(hit.object.parent.position).toArray().map((x) => shown(x, "m"));
    const { field, values } = this.current;
    const row = field.of === "points" ? this.triangles[3 * hit.faceIndex] : hit.faceIndex;
    const value = values ? `${field.label} ${shown(values[row], field.unit)} ` : "";
    const regions = this.body.regions.names.filter((_, n) => this.masks[Math.floor(n / 16)][hit.faceIndex] & (1 << n % 16));
    element("reading").textContent = `${value}at (${place.join(", ")})${regions.length ? `, ${regions.join(", ")}` : ""}`;
  }

  #draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      const forward = this.camera.position.clone().sub(this.orbit.target);
      this.lamp.position.copy(forward).applyAxisAngle(this.camera.up, 0.5).add(this.camera.up.clone().multiplyScalar(0.4 * forward.length()));
      this.renderer.render(this.scene, this.camera);
    });
  }
}

// Mean length of the first side of triangles.
function meanSide(points, corners) {
  let sum = 0;
  for (let i = 0; i < corners.length; i += 3) {
    const [a, b] = [3 * corners[i], 3 * corners[i + 1]];
    sum += Math.hypot(points[a] - points[b], points[a + 1] - points[b + 1], points[a + 2] - points[b + 2]);
  }
  return (3 * sum) / corners.length;
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

// Least and largest coordinate of points along a direction.
function extent(points, way) {
  let low = Infinity, high = -Infinity;
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i] * way.x + points[i + 1] * way.y + points[i + 2] * way.z;
    if (x < low) low = x;
    if (x > high) high = x;
  }
  return [low, high];
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
    const viewer = new Viewer();
    await viewer.start();
    document.documentElement.dataset.viewer = "ready";
  } catch (error) {
    unavailable(`The interactive picture could not be started: ${error.message}`);
  }
}

main();
