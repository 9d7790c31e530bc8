// Viridis (matplotlib, CC0) by a polynomial through its table, and colours of regions (Okabe & Ito).
const C = [
  [0.2777273272234177, 0.005407344544966578, 0.3340998053353061],
  [0.1050930431085774, 1.404613529898575, 1.384590162594685],
  [-0.3308618287255563, 0.214847559468213, 0.09509516302823659],
  [-4.634230498983486, -5.799100973351585, -19.33244095627987],
  [6.228269936347081, 14.17993336680509, 56.69055260068105],
  [4.776384997670288, -13.74514537774601, -65.35303263337234],
  [-5.435455855934631, 4.645852612178535, 26.3124352495832],
];

export function viridis(t, out, at) {
  const x = Math.min(1, Math.max(0, t));
  for (let k = 0; k < 3; k++) {
    let value = 0;
    for (let i = 6; i >= 0; i--) value = value * x + C[i][k];
    out[at + k] = Math.min(1, Math.max(0, value));
  }
}

export const REGIONS = ["#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#0072b2", "#d55e00", "#f0e442", "#999999"];
export const SUPPORTS = ["#0072b2", "#56b4e9", "#004466", "#88aacc"];
export const LOADS = ["#d55e00", "#e69f00", "#cc79a7", "#8b2500"];

export const TENSION = "#d55e00", COMPRESSION = "#0072b2", CHOSEN = "#f0e442";

export const hex = (text) => [1, 3, 5].map((i) => parseInt(text.slice(i, i + 2), 16) / 255);
export const linear = (c) => (c < 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
export const GREY = linear(0.8);

export function css(r, g, b) {
  return `rgb(${Math.round(255 * r)},${Math.round(255 * g)},${Math.round(255 * b)})`;
}
