// Sorts and filters the table of all grasps; it works where figures cannot be drawn.
"use strict";
(function () {
  const grasps = document.getElementById("grasps");
  if (!grasps) return;
  const body = grasps.tBodies[0];
  const rows = [...body.rows];
  const words = document.getElementById("filter");
  const holds = document.getElementById("filter-holds");
  const said = document.getElementById("filtered");
  const value = (row, column) => {
    const cell = row.cells[column];
    return cell.dataset.value === undefined ? null : Number(cell.dataset.value);
  };

  function filter() {
    const wanted = words.value.toLowerCase();
    let shown = 0;
    for (const row of rows) {
      row.hidden = (holds.value && row.dataset.holds !== holds.value) || !(row.textContent + " " + row.dataset.name).toLowerCase().includes(wanted);
      shown += row.hidden ? 0 : 1;
    }
    said.textContent = shown + " of " + rows.length + " rows";
  }

  function compare(column, up) {
    return (one, other) => {
      const a = value(one, column), b = value(other, column);
      if (a !== null && b !== null) return a === b ? 0 : (up ? 1 : -1) * (a < b ? -1 : 1);
      // What has no value stands last, whichever way it is sorted.
      if (a !== null || b !== null) return a === null ? 1 : -1;
      const order = one.cells[column].textContent.localeCompare(other.cells[column].textContent, undefined, { numeric: true });
      return up ? order : -order;
    };
  }

  grasps.querySelectorAll(".sort").forEach((button, column) => button.addEventListener("click", () => {
    const head = button.closest("th");
    const up = head.getAttribute("aria-sort") !== "ascending";
    for (const other of grasps.querySelectorAll("th")) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    rows.sort(compare(column, up));
    body.append(...rows);
  }));
  words.addEventListener("input", filter);
  holds.addEventListener("change", filter);
})();
