// Fields that a body can be coloured by. Values of points have one number for each point, others one for each triangle.

const SXX = 0, SYY = 1, SZZ = 2, SXY = 3, SYZ = 4, SXZ = 5;

function each(array, f) {
  const { rows, components, values } = array;
  const found = new Float32Array(rows);
  const row = new Float64Array(components);
  for (let i = 0; i < rows; i++) {
    for (let k = 0; k < components; k++) row[k] = values[i * components + k];
    found[i] = f(row);
  }
  return found;
}

function vonMises(s) {
  const p = (s[SXX] + s[SYY] + s[SZZ]) / 3;
  const normal = (s[SXX] - p) ** 2 + (s[SYY] - p) ** 2 + (s[SZZ] - p) ** 2;
  return Math.sqrt(1.5 * normal + 3 * (s[SXY] ** 2 + s[SYZ] ** 2 + s[SXZ] ** 2));
}

// Principal stresses by the trigonometric solution of the characteristic equation, largest first.
function principal(s, which) {
  const p = (s[SXX] + s[SYY] + s[SZZ]) / 3;
  const radius = vonMises(s) / 3; // √(J2/3)
  if (!radius) return p;
  const [a, b, c] = [s[SXX] - p, s[SYY] - p, s[SZZ] - p];
  const [d, e, f] = [s[SXY], s[SYZ], s[SXZ]];
  const J3 = a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f);
  const angle = Math.acos(Math.min(1, Math.max(-1, J3 / (2 * radius ** 3)))) / 3;
  return p + 2 * radius * Math.cos(angle - (2 * Math.PI * which) / 3);
}

export const FIELDS = [
  { id: "displacement", label: "displacement", unit: "m", of: "points" },
  { id: "von-mises", label: "von Mises stress", unit: "Pa", from: (r) => each(r.stress, vonMises) },
  { id: "pressure", label: "pressure −tr σ/3", unit: "Pa", from: (r) => each(r.stress, (s) => -(s[SXX] + s[SYY] + s[SZZ]) / 3) },
  ...["first", "second", "third"].map((name, k) => ({
    id: `principal-stress-${k + 1}`,
    label: `${name} principal Cauchy stress`,
    unit: "Pa",
    from: (r) => each(r.stress, (s) => principal(s, k)),
  })),
  ...["xx", "yy", "zz", "xy", "yz", "xz"].map((name, k) => ({
    id: `s${name}`,
    label: `Cauchy stress σ${name}`,
    unit: "Pa",
    from: (r) => each(r.stress, (s) => s[k]),
  })),
  ...["first", "second", "third"].map((name, k) => ({
    id: `stretch-${k + 1}`,
    label: `${name} principal stretch`,
    unit: "",
    from: (r) => each(r.stretches, (s) => s[k]),
  })),
  { id: "J", label: "volume ratio J", unit: "", from: (r) => r.J.values },
  { id: "deviation", label: "standard deviation over the cases", unit: "m", of: "points", from: (r) => r.deviation?.values },
  { id: "error", label: "estimated error of the displacement gradient", unit: "", from: (r, body) => body.error?.values },
  { id: "regions", label: "regions", unit: "", regions: true },
  { id: "none", label: "one colour", unit: "" },
];

const PREFIXES = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];
const units = {}; // of the job, by the SI unit: [size, symbol]

export function useUnits(chosen) { Object.assign(units, chosen); }

// The unit in which values up to `most` are shown: [size, symbol].
export function unitOf(most, unit) {
  if (!unit) return [1, ""];
  if (units[unit]) return units[unit];
  const size = Math.abs(most);
  const [scale, prefix] = size === 0 || !Number.isFinite(size) ? [1, ""] : (PREFIXES.find(([s]) => size >= s) ?? PREFIXES.at(-1));
  return [scale, prefix + unit];
}

export function shown(value, unit) {
  if (!Number.isFinite(value)) return "not known";
  const [size, symbol] = unitOf(value, unit);
  return `${inUnit(value, size)}${symbol ? ` ${symbol}` : ""}`;
}

export function inUnit(value, size) { return Number((value / size).toPrecision(4)).toString(); }

// Eigenvalues and unit eigenvectors of a symmetric matrix (xx, yy, zz, xy, yz, xz) by Jacobi's rotations.
export function principals(s) {
  const a = [[s[SXX], s[SXY], s[SXZ]], [s[SXY], s[SYY], s[SYZ]], [s[SXZ], s[SYZ], s[SZZ]]];
  const v = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 12; sweep++)
    for (const [p, q] of [[0, 1], [1, 2], [0, 2]]) {
      if (!a[p][q]) continue;
      const theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
      const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1)), c = 1 / Math.hypot(t, 1), d = t * c;
      for (const m of [a, v]) for (let i = 0; i < 3; i++) [m[i][p], m[i][q]] = [c * m[i][p] - d * m[i][q], d * m[i][p] + c * m[i][q]];
      for (let i = 0; i < 3; i++) [a[p][i], a[q][i]] = [c * a[p][i] - d * a[q][i], d * a[p][i] + c * a[q][i]];
    }
  return [0, 1, 2].map((k) => ({ value: a[k][k], way: [v[0][k], v[1][k], v[2][k]] }));
}
