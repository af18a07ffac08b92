"use strict";
(() => {
  const source = document.getElementById("edge-rows");
  if (!source) return;
  const rows = JSON.parse(source.textContent);
  const table = document.getElementById("edge-table");
  const heads = [...table.tHead.rows[0].cells];
  const only = document.getElementById("only");
  const more = document.getElementById("more");
  const STEP = 25;
  let shown = STEP, column = -1, sign = 1;

  function compare(a, b) {
    const [x, y] = [a[column], b[column]];
    if (x === null || y === null) return (x === null) - (y === null);  // unknown always last
    return sign * (typeof x === "number" ? x - y : x.localeCompare(y, undefined, { numeric: true }));
  }

  function text(value) {
    return value === null ? "" : typeof value === "number" && !Number.isInteger(value) ? value.toFixed(2) : value;
  }

  function draw() {
    const frame = only.value.trim();
    let list = frame === "" ? rows : rows.filter(row => String(row[0]) === frame || String(row[1]) === frame);
    if (column >= 0) list = [...list].sort(compare);
    table.tBodies[0].replaceChildren(...list.slice(0, shown).map(row => {
      const line = document.createElement("tr");
      for (const value of row) line.insertCell().textContent = text(value);
      return line;
    }));
    document.getElementById("count").textContent = `${Math.min(shown, list.length)} of ${list.length} edges`;
    more.hidden = shown >= list.length;
  }

  heads.forEach((head, k) => head.firstElementChild.addEventListener("click", () => {
    // Numbers are most telling from the largest down, except the frames' own.
    sign = column === k ? -sign : k > 1 && rows.some(row => typeof row[k] === "number") ? -1 : 1;
    column = k;
    heads.forEach(other => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
    draw();
  }));
  only.addEventListener("input", () => { shown = STEP; draw(); });
  more.addEventListener("click", () => { shown += 20 * STEP; draw(); });
  draw();
})();
