// One body of the picture: its surface, edges, fibres and symbols, at positions that change with the sliders.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, ConeGeometry, CylinderGeometry, DoubleSide, Group, InstancedMesh,
  LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, Object3D, Quaternion, Vector3,
} from "three";
import { COMPRESSION, LOADS, SUPPORTS, TENSION } from "./colours.js";
import { Section } from "./section.js";

const SHARP = Math.cos((35 * Math.PI) / 180);
const ARROW = 0.07; // length relative to the body
const UP = new Vector3(0, 1, 0);

// Pairs of points on sharp edges of the surface, in its first shape.
function sharpEdges(points, corners) {
  const seen = new Map();
  const found = [];
  const normal = (t) => {
    const p = [0, 1, 2].map((k) => new Vector3().fromArray(points, 3 * corners[3 * t + k]));
    return p[1].sub(p[0]).cross(p[2].sub(p[0])).normalize();
  };
  for (let t = 0; t < corners.length / 3; t++) {
    const own = normal(t);
    for (let k = 0; k < 3; k++) {
      const a = corners[3 * t + k], b = corners[3 * t + ((k + 1) % 3)];
      const key = a < b ? a * 65536 + b : b * 65536 + a;
      const other = seen.get(key);
      if (other === undefined) seen.set(key, own);
      else {
        seen.set(key, null);
        if (other && other.dot(own) < SHARP) found.push(a, b);
      }
    }
  }
  return found;
}

export class Shape {
  constructor(corners, first, { opacity = 1, edges, interior = null } = {}) {
    this.corners = corners;
    this.isPicked = opacity === 1;
    this.hidden = null; // whether each triangle is left out
    this.group = new Group();
    const count = corners.length;
    this.geometry = new BufferGeometry();
    this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * count), 3));
    this.geometry.setAttribute("color", new BufferAttribute(new Float32Array(3 * count).fill(0.85), 3));
    this.material = new MeshLambertMaterial({
      vertexColors: true, side: DoubleSide, flatShading: true, transparent: opacity < 1, opacity, depthWrite: opacity === 1,
      polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
    });
    this.mesh = new Mesh(this.geometry, this.material);
    this.mesh.frustumCulled = false;
    this.edges = edges ?? sharpEdges(first, corners);
    this.edgeGeometry = new BufferGeometry();
    this.edgeGeometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * this.edges.length), 3));
    this.edgeMaterial = new LineBasicMaterial({ color: 0x444444, transparent: opacity < 1, opacity: Math.min(1, 2 * opacity) });
    this.lines = new LineSegments(this.edgeGeometry, this.edgeMaterial);
    this.lines.frustumCulled = false;
    this.fibres = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0x111111 }));
    this.fibres.frustumCulled = false;
    this.symbols = new Group();
    this.glyphs = new Group();
    this.section = new Section(interior);
    this.group.add(this.mesh, this.lines, this.fibres, this.symbols, this.glyphs, ...this.section.parts);
  }

  // Materials that the cut removes on one side.
  get clipped() { return [this.material, this.edgeMaterial, this.fibres.material, this.section.skinMaterial]; }

  place(points) {
    this.points = points;
    gather(this.geometry.attributes.position, this.corners, points);
    gather(this.edgeGeometry.attributes.position, this.edges, points);
    const { array } = this.geometry.attributes.position;
    this.hidden?.forEach((isHidden, t) => { if (isHidden) array.fill(array[9 * t], 9 * t, 9 * t + 9); });
  }

  // Vectors as arrows: rows [start, vector] with a colour; `length` is that of the drawn largest one.
  drawVectors(vectors, length) {
    const most = Math.max(...vectors.map(([, v]) => v.length()), 1e-300);
    const ends = vectors.filter(([, v]) => v.length() > 0.02 * most).map(([start, v]) => {
      const size = (v.length() / most) * length;
      const way = v.clone().normalize();
      return [start.clone().addScaledVector(way, size), way, size];
    });
    this.#arrows(ends, length, new MeshLambertMaterial({ color: 0x222222 }), this.glyphs);
  }

  // Principal values as bars: rows [middle, unit direction, value], of two colours by their sign.
  drawCrosses(bars, length) {
    const most = Math.max(...bars.map(([, , value]) => Math.abs(value)), 1e-300);
    for (const [sign, colour] of [[1, TENSION], [-1, COMPRESSION]]) {
      const own = bars.filter(([, , value]) => Math.sign(value) === sign && Math.abs(value) > 0.02 * most);
      const radius = 0.035 * length;
      const mesh = new InstancedMesh(new CylinderGeometry(radius, radius, 1, 6), new MeshBasicMaterial({ color: colour }), own.length);
      const place = new Object3D();
      own.forEach(([middle, way, value], i) => {
        place.position.copy(middle);
        place.quaternion.setFromUnitVectors(UP, way);
        place.scale.set(1, (Math.abs(value) / most) * length, 1);
        place.updateMatrix();
        mesh.setMatrixAt(i, place.matrix);
      });
      mesh.frustumCulled = false;
      this.glyphs.add(mesh);
    }
  }

  centre(triangle, out) {
    out.set(0, 0, 0);
    for (let k = 0; k < 3; k++) {
      const at = 3 * this.corners[3 * triangle + k];
      out.x += this.points[at] / 3; out.y += this.points[at + 1] / 3; out.z += this.points[at + 2] / 3;
    }
    return out;
  }

  normal(triangle, out) {
    const [a, b, c] = [0, 1, 2].map((k) => new Vector3().fromArray(this.points, 3 * this.corners[3 * triangle + k]));
    return out.copy(b.sub(a).cross(c.sub(a))).normalize();
  }

  // Lines of fibres at every n-th triangle, along directions (rows of 3).
  drawFibres(directions, every, length) {
    const count = directions ? directions.length / 3 : 0;
    const ends = new Float32Array(6 * count);
    const middle = new Vector3();
    for (let i = 0; i < count; i++) {
      this.centre(i * every, middle);
      for (let k = 0; k < 3; k++) {
        const half = 0.5 * length * directions[3 * i + k];
        ends[6 * i + k] = middle.getComponent(k) - half;
        ends[6 * i + 3 + k] = middle.getComponent(k) + half;
      }
    }
    this.fibres.geometry.dispose();
    this.fibres.geometry = new BufferGeometry();
    this.fibres.geometry.setAttribute("position", new BufferAttribute(ends, 3));
    this.fibres.visible = count > 0;
  }

  // Cubes where all is held, else arrows; loads point along their direction, or into the body.
  drawSymbols(symbols, size, box, { loads = true } = {}) {
    this.symbols.clear();
    const numbers = { support: 0, load: 0 };
    for (const symbol of symbols) {
      const palette = symbol.kind === "support" ? SUPPORTS : LOADS;
      const colour = palette[numbers[symbol.kind]++ % palette.length];
      if (symbol.kind === "load" && !loads) continue;
      const material = new MeshLambertMaterial({ color: new Color(colour), clippingPlanes: this.material.clippingPlanes });
      if (symbol.kind === "support" && symbol.fixed.length === 3) this.#cubes(symbol.rows, 0.22 * ARROW * size, material);
      else if (symbol.kind === "support") for (const axis of symbol.fixed) this.#axis(symbol.rows, axis, size, material);
      else if (symbol.rows.length) this.#loads(symbol, size, material);
      else if (symbol.body && symbol.vector) {
        material.clippingPlanes = null; // it stands outside of the body
        this.#beside(symbol.vector, box, size, material);
      }
    }
  }

  #cubes(rows, side, material) {
    const mesh = new InstancedMesh(new BoxGeometry(side, side, side), material, rows.length);
    const middle = new Vector3(), matrix = new Matrix4();
    rows.forEach((row, i) => mesh.setMatrixAt(i, matrix.makeTranslation(this.centre(row, middle))));
    mesh.frustumCulled = false;
    this.symbols.add(mesh);
  }

  #axis(rows, axis, size, material) {
    const along = new Vector3().setComponent("xyz".indexOf(axis), 1);
    const normal = new Vector3();
    const ends = rows.map((row) => {
      const side = this.normal(row, normal).dot(along) > 0 ? -1 : 1;
      return [this.centre(row, new Vector3()), along.clone().multiplyScalar(side)];
    });
    this.#arrows(ends, 0.6 * ARROW * size, material);
  }

  #loads({ rows, vector }, size, material) {
    const ends = rows.map((row) => {
      const way = vector ? new Vector3().fromArray(vector) : this.normal(row, new Vector3()).negate();
      return [this.centre(row, new Vector3()), way];
    });
    this.#arrows(ends, ARROW * size, material);
  }

  #beside(vector, box, size, material) {
    const way = new Vector3().fromArray(vector);
    const middle = box.getCenter(new Vector3()), half = box.getSize(new Vector3()).multiplyScalar(0.5);
    const reach = Math.abs(half.x * way.x) + Math.abs(half.y * way.y) + Math.abs(half.z * way.z) + 0.03 * size;
    this.#arrows([[middle.addScaledVector(way, -reach), way]], 2 * ARROW * size, material);
  }

  // Arrows (end, unit direction, and their length if it differs).
  #arrows(ends, length, material, group = this.symbols) {
    const shaft = new CylinderGeometry(0.04 * length, 0.04 * length, 0.68 * length, 6).translate(0, -0.66 * length, 0);
    const tip = new ConeGeometry(0.12 * length, 0.32 * length, 10).translate(0, -0.16 * length, 0);
    for (const geometry of [shaft, tip]) {
      const mesh = new InstancedMesh(geometry, material, ends.length);
      const place = new Object3D();
      ends.forEach(([end, way, own = length], i) => {
        place.scale.setScalar(own / length);
        place.position.copy(end);
        place.quaternion.copy(new Quaternion().setFromUnitVectors(UP, way));
        place.updateMatrix();
        mesh.setMatrixAt(i, place.matrix);
      });
      mesh.frustumCulled = false;
      group.add(mesh);
    }
  }
}

function gather(attribute, rows, points) {
  const out = attribute.array;
  for (let i = 0; i < rows.length; i++) {
    const at = 3 * rows[i];
    out[3 * i] = points[at]; out[3 * i + 1] = points[at + 1]; out[3 * i + 2] = points[at + 2];
  }
  attribute.needsUpdate = true;
}
