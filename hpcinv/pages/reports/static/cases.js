// Filter of the table of cases, and diagrams that show the same cases.
(() => {
  const { columns, rows, outcome, axes } = JSON.parse(document.getElementById("cases").textContent);
  const lines = [...document.querySelectorAll("#table tbody tr")].sort((a, b) => a.dataset.row - b.dataset.row);
  const element = (id) => document.getElementById(id);
  const named = (text) => {
    const name = text.trim().toLowerCase();
    const find = (fits) => columns.findIndex((c) => fits(c.name.toLowerCase()));
    const exact = find((n) => n === name);
    return exact >= 0 ? exact : find((n) => n.includes(name));
  };
  const status = columns.findIndex((c) => c.name === "status");
  const cropped = (text, most) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);
  const short = (x) => (typeof x === "number" ? Number(x.toPrecision(Math.abs(x) < 1e-2 ? 2 : 4)).toString() : String(x));

  function condition(text) {
    const parts = text.match(/^(.+?)\s*(<=|>=|<|>|=)\s*(.+)$/);
    if (!parts) {
      const word = text.trim().toLowerCase();
      return (row) => row.some((value) => value !== null && String(value).toLowerCase().includes(word));
    }
    const column = named(parts[1]);
    if (column < 0) return null;
    const wanted = columns[column].text ? parts[3].trim().toLowerCase() : Number(parts[3]);
    const test = { "<": (a) => a < wanted, ">": (a) => a > wanted, "<=": (a) => a <= wanted, ">=": (a) => a >= wanted,
      "=": (a) => (columns[column].text ? String(a).toLowerCase() === wanted : a === wanted) }[parts[2]];
    return (row) => row[column] !== null && test(row[column]);
  }

  let shown = rows.map(() => true);
  function filter() {
    const texts = element("filter").value.split(",").filter((text) => text.trim());
    const tests = texts.map(condition);
    const wrong = texts.filter((_, i) => tests[i] === null);
    shown = rows.map((row) => tests.every((test) => test === null || test(row)));
    lines.forEach((line, i) => { line.hidden = !shown[i]; });
    const count = `${shown.filter(Boolean).length} of ${rows.length} cases`;
    element("filter-count").textContent = wrong.length ? `${count}; no column for: ${wrong.join(", ")}` : count;
    draw();
  }

  // Place of a value on an axis, from 0 to 1; texts are in alphabetical order.
  function scale(column) {
    const values = rows.map((row) => row[column]).filter((value) => value !== null && value !== "");
    if (columns[column].text) {
      const distinct = [...new Set(values)].sort();
      const at = (value) => (distinct.length > 1 ? distinct.indexOf(value) / (distinct.length - 1) : 0.5);
      return { at, ticks: distinct.length > 9 ? [] : distinct.map((value) => [at(value), value]), low: "", high: "" };
    }
    const low = Math.min(...values), high = Math.max(...values);
    if (low > 0 && high / low > 300) {
      const [a, b] = [Math.log10(low), Math.log10(high)];
      return { at: (value) => (Math.log10(value) - a) / (b - a), low, high, ticks: [0, 0.25, 0.5, 0.75, 1].map((t) => [t, 10 ** (a + t * (b - a))]) };
    }
    const at = (value) => (high > low ? (value - low) / (high - low) : 0.5);
    return { at, low, high, ticks: high > low ? [0, 0.25, 0.5, 0.75, 1].map((t) => [t, low + t * (high - low)]) : [[0.5, low]] };
  }

  const make = (name, attributes, parent, text) => {
    const one = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
    if (text !== undefined) one.textContent = text;
    parent.append(one);
    return one;
  };

  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  // Viridis at five places.
  const STOPS = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  function colourOf(column) {
    if (column < 0) return (i) => ({ good: style("--c0"), doubtful: style("--warn"), bad: style("--fail"), open: style("--soft") })[outcome[i]];
    const { at } = scale(column);
    if (columns[column].text) {
      const distinct = [...new Set(rows.map((row) => row[column]))].sort();
      return (i) => style(`--c${distinct.indexOf(rows[i][column]) % 8}`);
    }
    return (i) => {
      if (rows[i][column] === null) return style("--soft");
      const place = 4 * at(rows[i][column]), k = Math.min(3, Math.floor(place)), t = place - k;
      return `rgb(${STOPS[k].map((a, c) => Math.round(a + t * (STOPS[k + 1][c] - a))).join(",")})`;
    };
  }

  function choose(i, yes) {
    lines[i].classList.toggle("chosen", yes);
    document.querySelectorAll(`[data-case="${i}"]`).forEach((one) => one.classList.toggle("chosen", yes));
  }
  function link(one, i) {
    one.dataset.case = i;
    one.addEventListener("pointerenter", () => choose(i, true));
    one.addEventListener("pointerleave", () => choose(i, false));
    const values = axes.filter((c) => rows[i][c] !== null && rows[i][c] !== "").map((c) => `${columns[c].name} ${short(rows[i][c])}`);
    const reason = status >= 0 && rows[i][status] !== "converged" ? `; ${rows[i][status]}` : "";
    make("title", {}, one, `case ${rows[i][0]}: ${values.join(", ")}${reason}`);
  }

  function drawMap() {
    const svg = element("map");
    svg.replaceChildren();
    const [x, y] = ["map-x", "map-y"].map((id) => Number(element(id).value));
    const [across, upward] = [scale(x), scale(y)];
    const place = (row) => [70 + 470 * across.at(row[x]), 345 - 325 * upward.at(row[y])];
    for (const [t, value] of upward.ticks) {
      make("line", { class: "grid", x1: 62, x2: 548, y1: 345 - 325 * t, y2: 345 - 325 * t }, svg);
      make("text", { x: 58, y: 349 - 325 * t, "text-anchor": "end" }, svg, short(value));
    }
    for (const [t, value] of across.ticks) make("text", { x: 70 + 470 * t, y: 366, "text-anchor": "middle" }, svg, short(value));
    make("text", { x: 305, y: 390, "text-anchor": "middle" }, svg, cropped(columns[x].label, 70));
    make("text", { transform: "translate(14 182) rotate(-90)", "text-anchor": "middle" }, svg, cropped(columns[y].label, 45));
    const column = Number(element("map-colour").value);
    const colour = colourOf(column);
    rows.forEach((row, i) => {
      if (!shown[i] || row[x] === null || row[y] === null) return;
      const [px, py] = place(row);
      const bad = outcome[i] === "bad";
      const one = bad
        ? make("path", { class: "case", d: `M${px - 5} ${py - 5}l10 10m0 -10l-10 10`, stroke: style("--fail") }, svg)
        : make("circle", { class: "case", cx: px, cy: py, r: 4.5, fill: outcome[i] === "open" ? "none" : colour(i), stroke: outcome[i] === "open" ? style("--soft") : "none" }, svg);
      link(one, i);
    });
    const range = column >= 0 && !columns[column].text ? scale(column) : null;
    element("map-scale").textContent = range ? `Colours from ${short(range.low)} (dark) to ${short(range.high)} (light).` : column < 0 ? "Blue: good; ochre: doubtful." : "";
  }

  function drawParallel() {
    const svg = element("parallel");
    svg.replaceChildren();
    const scales = axes.map(scale);
    const place = (k) => (axes.length > 1 ? 40 + (480 * k) / (axes.length - 1) : 280);
    const colour = colourOf(Number(element("map-colour").value));
    rows.forEach((row, i) => {
      if (!shown[i]) return;
      const known = axes.map((c, k) => (row[c] === null || row[c] === "" ? null : [place(k), 350 - 300 * scales[k].at(row[c])]));
      let d = "", before = false;
      for (const point of known) { if (point) d += `${before ? "L" : "M"}${point.map((v) => v.toFixed(1)).join(" ")}`; before = Boolean(point); }
      link(make("path", { d, stroke: outcome[i] === "bad" ? style("--fail") : colour(i) }, svg), i);
    });
    axes.forEach((c, k) => {
      const anchor = axes.length > 1 && k === 0 ? "start" : k === axes.length - 1 && k ? "end" : "middle";
      make("line", { class: "axis", x1: place(k), x2: place(k), y1: 50, y2: 350 }, svg);
      make("text", { x: place(k) + { start: -36, middle: 0, end: 36 }[anchor], y: k % 2 ? 16 : 32, "text-anchor": anchor }, svg, cropped(columns[c].label, 26));
      make("text", { x: place(k), y: 366, "text-anchor": "middle" }, svg, short(scales[k].low));
      make("text", { x: place(k), y: 45, "text-anchor": "middle" }, svg, short(scales[k].high));
    });
  }

  function draw() { drawMap(); drawParallel(); }

  columns.forEach((column, i) => {
    if (i) for (const id of ["map-x", "map-y"]) element(id).add(new Option(column.label, i));
  });
  element("map-colour").add(new Option("outcome", -1));
  axes.forEach((c) => element("map-colour").add(new Option(columns[c].label, c)));
  element("map-x").value = axes[0] ?? 1;
  element("map-y").value = axes[1] ?? axes[0] ?? 1;
  for (const id of ["map-x", "map-y", "map-colour"]) element(id).addEventListener("change", draw);
  element("filter").addEventListener("input", filter);
  document.addEventListener("themechange", draw);
  lines.forEach((line, i) => {
    line.addEventListener("pointerenter", () => choose(i, true));
    line.addEventListener("pointerleave", () => choose(i, false));
  });
  filter();
})();
