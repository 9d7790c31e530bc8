// Theme, and tables that sort by their heads.
(() => {
  const root = document.documentElement;
  const choice = document.getElementById("theme");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const apply = () => {
    root.dataset.theme = choice.value === "auto" ? (system.matches ? "dark" : "light") : choice.value;
    document.dispatchEvent(new Event("themechange"));
  };
  choice.addEventListener("change", apply);
  system.addEventListener("change", apply);
  apply();

  const value = (row, column) => {
    const cell = row.cells[column];
    const text = cell.dataset.value ?? cell.textContent.trim().replaceAll(",", "");
    const number = parseFloat(text);
    return cell.classList.contains("n") ? (Number.isNaN(number) ? null : number) : text;
  };
  const compare = (a, b) => {
    if (a === null || b === null) return (a === null) - (b === null);
    return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), "en", { numeric: true });
  };
  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      if (head.dataset.sort === "none") return;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        const rows = [...table.tBodies[0].rows].map((row) => [value(row, column), row]);
        const missing = ([one]) => one === null;
        rows.sort((a, b) => (missing(a) || missing(b) ? missing(a) - missing(b) : (up ? 1 : -1) * compare(a[0], b[0])));
        table.tBodies[0].append(...rows.map(([, row]) => row));
      });
    });
  }
})();
