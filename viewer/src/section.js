// The filled section of a body: triangles where a plane cuts its tetrahedra, and lines where it cuts their interfaces.

import { BufferAttribute, BufferGeometry, DoubleSide, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial } from "three";

export class Section {
  constructor(interior) {
    this.interior = interior; // { tetrahedra, interfaces, owners: their two tetrahedra }, or null
    this.mesh = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ vertexColors: true, side: DoubleSide }));
    this.mesh.frustumCulled = false;
    this.mesh.userData.isSection = true;
    this.lines = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ color: 0x111111 }));
    this.lines.frustumCulled = false;
    this.mesh.visible = this.lines.visible = false;
    this.skinMaterial = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide, flatShading: true });
    this.skin = new Mesh(new BufferGeometry(), this.skinMaterial); // interfaces next to regions that are left out
    this.skin.frustumCulled = false;
    this.skin.visible = false;
    this.parts = [this.mesh, this.lines, this.skin];
    this.rows = [];
  }

  // Draws interfaces with one side shown, coloured by the tetrahedron there.
  placeSkin(points, isShown, paint) {
    const positions = [], owners = [];
    const { interfaces, owners: sides } = this.interior;
    for (let f = 0; f < interfaces.length / 3; f++) {
      const [a, b] = [sides[2 * f], sides[2 * f + 1]];
      if (isShown(a) === isShown(b)) continue;
      for (let i = 0; i < 3; i++) for (let n = 0; n < 3; n++) positions.push(points[3 * interfaces[3 * f + i] + n]);
      owners.push(isShown(a) ? a : b);
    }
    const colours = new Float32Array(positions.length);
    owners.forEach((row, i) => { for (let n = 0; n < 3; n++) paint(colours, 9 * i + 3 * n, row, null); });
    this.skin.geometry.dispose();
    this.skin.geometry = new BufferGeometry();
    this.skin.geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
    this.skin.geometry.setAttribute("color", new BufferAttribute(colours, 3));
    this.skin.visible = owners.length > 0;
  }

  // Cuts the tetrahedra with nodes at `points`; `isShown` says which of them are drawn.
  place(points, cut, isShown = null) {
    this.mesh.visible = this.lines.visible = Boolean(this.interior && cut);
    this.rows = [];
    if (!this.mesh.visible) return;
    const { k, place } = cut;
    const positions = [];
    this.ends = []; // of the edge that each corner of a triangle is on: two points, and the share between them
    const rows = this.rows;
    const heights = this.#heights(points, k, place);
    const corner = (a, b) => {
      const share = heights[a] / (heights[a] - heights[b]);
      for (let i = 0; i < 3; i++) positions.push(points[3 * a + i] + share * (points[3 * b + i] - points[3 * a + i]));
      this.ends.push(a, b, share);
    };
    const { tetrahedra } = this.interior;
    const upper = [], lower = [];
    for (let t = 0; t < tetrahedra.length / 4; t++) {
      upper.length = lower.length = 0;
      for (let i = 0; i < 4; i++) (heights[tetrahedra[4 * t + i]] > 0 ? upper : lower).push(tetrahedra[4 * t + i]);
      if (!upper.length || !lower.length || (isShown && !isShown(t))) continue;
      if (upper.length === 2) {
        const [[a, b], [c, d]] = [upper, lower];
        corner(a, c); corner(a, d); corner(b, d);
        corner(a, c); corner(b, d); corner(b, c);
        rows.push(t, t);
      } else {
        for (const a of upper) for (const b of lower) corner(a, b);
        rows.push(t);
      }
    }
    this.mesh.geometry.dispose();
    this.mesh.geometry = new BufferGeometry();
    this.mesh.geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
    this.mesh.geometry.setAttribute("color", new BufferAttribute(new Float32Array(positions.length).fill(0.7), 3));
    this.#placeLines(points, heights);
  }

  #heights(points, k, place) {
    const heights = new Float64Array(points.length / 3);
    for (let i = 0; i < heights.length; i++) heights[i] = points[3 * i + k] - place || Number.MIN_VALUE;
    return heights;
  }

  #placeLines(points, heights) {
    const { interfaces } = this.interior, ends = [];
    for (let f = 0; f < interfaces.length; f += 3)
      for (const [i, j] of [[0, 1], [1, 2], [2, 0]]) {
        const a = interfaces[f + i], b = interfaces[f + j];
        if (heights[a] > 0 === heights[b] > 0) continue;
        const share = heights[a] / (heights[a] - heights[b]);
        for (let n = 0; n < 3; n++) ends.push(points[3 * a + n] + share * (points[3 * b + n] - points[3 * a + n]));
      }
    this.lines.geometry.dispose();
    this.lines.geometry = new BufferGeometry();
    this.lines.geometry.setAttribute("position", new BufferAttribute(new Float32Array(ends), 3));
  }

  // Colours each corner by `paint(out, at, row, value)`, where values of points are interpolated.
  colour(values, ofPoints, paint) {
    if (!this.mesh.visible) return;
    const attribute = this.mesh.geometry.attributes.color;
    for (let c = 0; c < 3 * this.rows.length; c++) {
      const row = this.rows[Math.floor(c / 3)];
      let value = null;
      if (values && ofPoints) {
        const [a, b, share] = this.ends.slice(3 * c, 3 * c + 3);
        value = values[a] + share * (values[b] - values[a]);
      } else if (values) value = values[row];
      paint(attribute.array, 3 * c, row, value);
    }
    attribute.needsUpdate = true;
  }

  // Middle of the n-th triangle.
  middle(n, out) {
    const at = this.mesh.geometry.attributes.position.array;
    return out.set(...[0, 1, 2].map((i) => (at[9 * n + i] + at[9 * n + 3 + i] + at[9 * n + 6 + i]) / 3));
  }
}
