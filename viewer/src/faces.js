// Facets of a boundary and the regions that a job can make of them; hpcinv/mesh/regions.py and smooth_faces.py count the same.

import { Vector3 } from "three";

const TIE = 1e-9; // relative: a limit that is nearer to a node is moved, since rounding would decide

export class Faces {
  // `vertices`: coordinates in m; `rows`: `sides` vertices for each facet, around it, seen from outside.
  constructor(vertices, rows, sides) {
    Object.assign(this, { vertices, rows, sides, count: rows.length / sides });
    this.normals = new Float64Array(3 * this.count);
    for (let f = 0; f < this.count; f++) {
      const [a, b, c, d] = this.corners(f);
      const normal = d ? c.clone().sub(a).cross(d.clone().sub(b)) : b.clone().sub(a).cross(c.clone().sub(a));
      normal.normalize().toArray(this.normals, 3 * f);
    }
  }

  vertex(row, out = new Vector3()) { return out.fromArray(this.vertices, 3 * row); }
  corners(f) { return Array.from({ length: this.sides }, (_, k) => this.vertex(this.rows[this.sides * f + k])); }
  normal(f) { return new Vector3().fromArray(this.normals, 3 * f); }
  middle(f) { return this.corners(f).reduce((sum, corner) => sum.add(corner), new Vector3()).divideScalar(this.sides); }
  extent(f) { const [a, b] = this.corners(f); return a.distanceTo(b); }

  // Facets of which all vertices, and the normal if it is asked for, fulfil a condition.
  where(holds, faces = () => true) {
    const inside = Array.from({ length: this.vertices.length / 3 }, (_, row) => holds(this.vertex(row)));
    return this.#filter((f) => faces(f) && Array.from({ length: this.sides }, (_, k) => inside[this.rows[this.sides * f + k]]).every(Boolean));
  }

  #filter(holds) { return Array.from({ length: this.count }, (_, f) => f).filter(holds); }

  // All facets that are reached from one over edges whose facets' normals differ by at most `angle` (rad).
  smoothWith(first, angle) {
    this.neighbours ??= this.#neighbours();
    const least = Math.cos(angle) - TIE;
    const reached = new Set([first]), front = [first];
    while (front.length) {
      const f = front.pop();
      for (const other of this.neighbours[f]) {
        if (reached.has(other) || this.normal(f).dot(this.normal(other)) < least) continue;
        reached.add(other);
        front.push(other);
      }
    }
    return [...reached].sort((a, b) => a - b);
  }

  #neighbours() {
    const edges = new Map();
    for (let f = 0; f < this.count; f++)
      for (let k = 0; k < this.sides; k++) {
        const a = this.rows[this.sides * f + k], b = this.rows[this.sides * f + ((k + 1) % this.sides)];
        const key = Math.min(a, b) * 65536 + Math.max(a, b);
        edges.set(key, [...(edges.get(key) ?? []), f]);
      }
    const neighbours = Array.from({ length: this.count }, () => []);
    for (const pair of edges.values()) if (pair.length === 2) { neighbours[pair[0]].push(pair[1]); neighbours[pair[1]].push(pair[0]); }
    return neighbours;
  }

  nearestVertex(place) {
    let best = Infinity, nearest = 0;
    const vertex = new Vector3();
    for (let row = 0; row < this.vertices.length / 3; row++) {
      const distance = this.vertex(row, vertex).distanceToSquared(place);
      if (distance < best) [best, nearest] = [distance, row];
    }
    return this.vertex(nearest);
  }

  // A short number between two levels, nearer to their middle than a third of their distance if it can be.
  static between(low, high) {
    const middle = (low + high) / 2, room = 0.3 * (high - low);
    if (Math.abs(middle) < room) return 0;
    for (let digits = 1; digits < 15; digits++) {
      const value = Number(middle.toPrecision(digits));
      if (Math.abs(value - middle) < room) return value;
    }
    return middle;
  }

  // The facets on the side of the body to which a facet looks: { text, facets }; `unit` is [size, symbol].
  side(f, size, unit) {
    const normal = this.normal(f), parts = normal.toArray();
    const k = parts.map(Math.abs).indexOf(Math.max(...parts.map(Math.abs))), sign = Math.sign(parts[k]);
    const levels = [...new Set(Array.from({ length: this.vertices.length / 3 }, (_, row) => sign * this.vertices[3 * row + k]))].sort((a, b) => b - a);
    const own = Math.min(...this.corners(f).map((corner) => sign * corner.getComponent(k)));
    let limit = levels.find((level) => level < own - 1e-3 * size) ?? own - size;
    if (own - limit < 0.01 * size) limit = own - 0.02 * size; // levels of a curved body are dense
    let place = Faces.between((sign * limit) / unit[0], (sign * own) / unit[0]);
    while (levels.some((level) => Math.abs(level - sign * place * unit[0]) < TIE * size)) place += 1e-6 * (size / unit[0]);
    const text = `${"xyz"[k]} ${sign > 0 ? ">" : "<"} ${quantity(place, unit[1])}`;
    return { text: `"${text}"`, facets: this.where((p) => sign * p.getComponent(k) > sign * place * unit[0]) };
  }

  // The facets around a point within a radius (in the unit) that look about as the facet there does.
  disc(f, place, radius, size, unit) {
    const centre = place.toArray().map((x) => rounded(x / unit[0], size / unit[0]));
    const middle = new Vector3(...centre.map((x) => x * unit[0]));
    const distances = Array.from({ length: this.vertices.length / 3 }, (_, row) => this.vertex(row).distanceTo(middle));
    let limit = radius;
    while (distances.some((distance) => Math.abs(distance - limit * unit[0]) < TIE * size)) limit = Number((limit * 1.0001).toPrecision(8));
    const normal = this.normal(f).toArray().map((x) => Number(x.toFixed(2)));
    const terms = normal.map((x, k) => [x, `n${"xyz"[k]}`]).filter(([x]) => x).map(([x, name]) => `${x}*${name}`);
    const offsets = centre.map((x, k) => (x ? `${"xyz"[k]} ${x > 0 ? "-" : "+"} ${quantity(Math.abs(x), unit[1])}` : "xyz"[k]));
    const text = `norm(${offsets.join(", ")}) < ${quantity(limit, unit[1])} and ${terms.join(" + ").replaceAll("+ -", "- ")} > 0.41`;
    const way = new Vector3(...normal);
    return { text: `"${text}"`, facets: this.where((p) => p.distanceTo(middle) < limit * unit[0], (g) => this.normal(g).dot(way) > 0.41) };
  }

  // The smooth face of a facet; the point that names it is the middle of the facet.
  smooth(f, degrees, unit) {
    const point = this.middle(f).toArray().map((x) => quantity(rounded(x / unit[0], (0.3 * this.extent(f)) / unit[0]), unit[1]));
    return { text: `{smooth: [${point.join(", ")}], angle: ${degrees} deg}`, facets: this.smoothWith(f, (degrees * Math.PI) / 180) };
  }
}

export function quantity(value, symbol) { return value === 0 ? "0" : `${value} ${symbol}`; }

// A number with as many decimals as 1/5000 of `size` needs.
export function rounded(value, size) {
  const decimals = Math.min(15, Math.max(0, Math.ceil(-Math.log10(size / 5000))));
  return Number(value.toFixed(decimals)) || 0;
}
