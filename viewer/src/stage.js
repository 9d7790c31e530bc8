// What all pages with a body share: camera, light, the cut, axes, and the keys that turn the body.

import { AmbientLight, Box3, DirectionalLight, OrthographicCamera, Plane, Quaternion, Raycaster, Scene, Spherical, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { shown } from "./fields.js";

export const element = (id) => document.getElementById(id);
export const on = (id, event, act) => element(id).addEventListener(event, () => act(element(id)));
const SVG = "http://www.w3.org/2000/svg";
const BEHIND = 1; // layer of what is drawn first

export class Stage {
  prepareStage() {
    const canvas = element("canvas");
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.localClippingEnabled = true;
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.scene = new Scene();
    this.camera = new OrthographicCamera(-1, 1, 1, -1, -1, 1);
    this.camera.up.fromArray(this.body.up);
    this.lamp = new DirectionalLight(0xffffff, 2.0);
    const light = new AmbientLight(0xffffff, 1.7);
    this.scene.add(light, this.lamp);
    for (const one of [light, this.lamp]) one.layers.enable(BEHIND);
    this.renderer.autoClear = false;
    this.clip = new Plane();
    this.planes = [];
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.enableDamping = false;
    this.orbit.addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.resize()).observe(canvas);
    canvas.addEventListener("keydown", (event) => this.#key(event));
    on("reset", "click", () => this.resetView());
    document.querySelectorAll("[data-view]").forEach((button) =>
      button.addEventListener("click", () => this.resetView(button.dataset.view)));
    document.addEventListener("themechange", () => this.update());
    on("clip-axis", "change", ({ value }) => { if (value !== "none") this.#faceSection("xyz".indexOf(value)); });
  }

  // Lets the other bodies cover a shape wherever it is, so that it veils no colours.
  putBehind(shape) { shape.group.traverse((part) => part.layers.set(BEHIND)); }

  // Keeps the far side of the cut, so that the section is seen.
  #faceSection(k) {
    const ahead = this.camera.position.getComponent(k) - this.orbit.target.getComponent(k);
    element("clip-side").checked = ahead < 0;
  }

  // Letters at the ends of an axis: x, or L and R of a patient.
  #letters(k) { return this.body.axes?.[k] ?? ["", "xyz"[k]]; }

  axisLabel(k) {
    const [low, high] = this.#letters(k);
    return low ? `${"xyz"[k]} (${low}–${high})` : high;
  }

  setBox(...clouds) {
    this.box = new Box3();
    for (const points of clouds) this.box.union(new Box3().setFromArray(points));
    this.size = this.box.getSize(new Vector3()).length();
  }

  // The plane of the cut: [axis, side that is kept, place], or null.
  get cut() {
    const axis = element("clip-axis").value;
    element("clip-place").disabled = element("clip-side").disabled = axis === "none";
    if (axis === "none") return null;
    const k = "xyz".indexOf(axis), [low, high] = [this.box.min.getComponent(k), this.box.max.getComponent(k)];
    // A plane through nodes would cut along sides of cells.
    const place = low + (Number(element("clip-place").value) / 100 + 1.3e-5) * (high - low);
    return { k, sign: element("clip-side").checked ? 1 : -1, place };
  }

  applyCut() {
    const { cut } = this;
    this.planes = [];
    if (cut) {
      const { k, sign, place } = cut;
      this.clip.normal.set(0, 0, 0).setComponent(k, sign);
      this.clip.constant = -sign * place;
      this.planes = [this.clip];
      element("clip-text").textContent = `${"xyz"[k]} = ${shown(Math.abs(place) < 1e-4 * this.size ? 0 : place, "m")}`;
    } else element("clip-text").textContent = "whole body";
    for (const shape of this.shapes) {
      // Planes are in space: a body that is moved aside takes its own with it.
      const own = this.planes.map((plane) => plane.clone().translate(shape.group.position));
      for (const part of shape.clipped) part.clippingPlanes = own;
    }
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
    this.frame();
    this.resize();
  }

  // Lets all bodies fill the picture in the present direction of view.
  frame() {
    this.camera.updateMatrixWorld();
    const [right, up, back] = [0, 1, 2].map((k) => new Vector3().setFromMatrixColumn(this.camera.matrixWorld, k));
    const spans = [right, up].map((way) => {
      let low = Infinity, high = -Infinity;
      for (const shape of this.shapes.filter((one) => one.group.visible)) {
        const [least, most] = extent(shape.points, way), aside = shape.group.position.dot(way);
        low = Math.min(low, least + aside);
        high = Math.max(high, most + aside);
      }
      return [low, high];
    });
    [this.wide, this.high] = spans.map(([low, high]) => high - low);
    const target = back.clone().multiplyScalar(this.orbit.target.dot(back));
    [right, up].forEach((way, k) => target.addScaledVector(way, (spans[k][0] + spans[k][1]) / 2));
    this.camera.position.add(target.clone().sub(this.orbit.target));
    this.orbit.target.copy(target);
    this.camera.updateMatrixWorld();
  }

  resize() {
    const canvas = element("canvas");
    const { clientWidth, clientHeight } = canvas;
    if (!clientWidth || !clientHeight || !this.wide) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    const aspect = clientWidth / clientHeight;
    const margin = 0.16 * this.size; // for symbols
    const high = Math.max(this.high + margin, (this.wide + margin) / aspect);
    Object.assign(this.camera, { left: (-high * aspect) / 2, right: (high * aspect) / 2, top: high / 2, bottom: -high / 2, near: 0, far: 8 * this.size + (this.gap ?? 0) });
    this.camera.updateProjectionMatrix();
    this.draw();
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
    this.draw();
  }

  // What is below the pointer: { shape, isSection, row, place }, or null.
  pick(event) {
    const { left, top, width: w, height: h } = element("canvas").getBoundingClientRect();
    const at = new Vector2((2 * (event.clientX - left)) / w - 1, 1 - (2 * (event.clientY - top)) / h);
    this.raycaster ??= new Raycaster();
    this.raycaster.setFromCamera(at, this.camera);
    const shapes = this.shapes.filter((shape) => shape.group.visible && shape.isPicked);
    const meshes = shapes.flatMap((shape) => [shape.mesh, ...(shape.section.mesh.visible ? [shape.section.mesh] : [])]);
    for (const mesh of meshes) mesh.geometry.boundingSphere = null;
    const local = (hit) => hit.point.clone().sub(hit.object.parent.position);
    const isKept = (hit) => hit.object.userData.isSection
      ? true : !this.isHidden?.(hit.faceIndex) && this.planes.every((plane) => plane.distanceToPoint(local(hit)) >= 0);
    const hit = this.raycaster.intersectObjects(meshes).find(isKept);
    if (!hit) return null;
    const shape = shapes.find(({ group }) => group === hit.object.parent);
    const isSection = Boolean(hit.object.userData.isSection);
    return { shape, isSection, row: isSection ? shape.section.rows[hit.faceIndex] : hit.faceIndex, place: local(hit) };
  }

  draw() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => {
      this.pending = false;
      const forward = this.camera.position.clone().sub(this.orbit.target);
      this.lamp.position.copy(forward).applyAxisAngle(this.camera.up, 0.5).add(this.camera.up.clone().multiplyScalar(0.4 * forward.length()));
      this.renderer.clear();
      for (const layer of [BEHIND, 0]) {
        this.camera.layers.set(layer);
        this.renderer.clearDepth();
        this.renderer.render(this.scene, this.camera);
      }
      this.#drawAxes();
    });
  }

  // Axes in the corner of the picture, in the direction of view.
  #drawAxes() {
    const drawing = element("axes");
    this.camera.updateMatrixWorld();
    const [right, up, back] = [0, 1, 2].map((k) => new Vector3().setFromMatrixColumn(this.camera.matrixWorld, k));
    const ways = [0, 1, 2].map((k) => new Vector3().setComponent(k, 1));
    const parts = [];
    for (const k of [0, 1, 2].sort((a, b) => ways[a].dot(back) - ways[b].dot(back))) {
      const [x, y] = [ways[k].dot(right), -ways[k].dot(up)];
      const [low, high] = this.#letters(k);
      const line = document.createElementNS(SVG, "line");
      const start = low ? -22 : 0;
      for (const [name, value] of Object.entries({ x1: start * x, y1: start * y, x2: 22 * x, y2: 22 * y, class: `axis-${"xyz"[k]}` })) line.setAttribute(name, value);
      parts.push(line);
      for (const [letter, way] of [[low, -1], [high, 1]]) {
        if (!letter || Math.hypot(x, y) < 0.2) continue;
        const text = document.createElementNS(SVG, "text");
        text.setAttribute("x", 31 * way * x);
        text.setAttribute("y", 31 * way * y);
        text.textContent = letter;
        parts.push(text);
      }
    }
    drawing.replaceChildren(...parts);
  }
}

// Mean length of the first side of triangles.
export function meanSide(points, corners) {
  let sum = 0;
  for (let i = 0; i < corners.length; i += 3) {
    const [a, b] = [3 * corners[i], 3 * corners[i + 1]];
    sum += Math.hypot(points[a] - points[b], points[a + 1] - points[b + 1], points[a + 2] - points[b + 2]);
  }
  return (3 * sum) / corners.length;
}

// Least and largest coordinate of points along a direction.
export function extent(points, way) {
  let low = Infinity, high = -Infinity;
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i] * way.x + points[i + 1] * way.y + points[i + 2] * way.z;
    if (x < low) low = x;
    if (x > high) high = x;
  }
  return [low, high];
}
