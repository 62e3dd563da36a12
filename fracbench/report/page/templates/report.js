"use strict";
// Tables sort by the buttons in their headings. Cells that say nothing stay below, whichever the direction.
const collator = new Intl.Collator("en", { numeric: true, sensitivity: "base" });
const number = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;

function sortValue(row, column) {
  const cell = row.cells[column];
  return cell ? (cell.dataset.sort ?? cell.textContent).trim() : "";
}

function compare(a, b) {
  return number.test(a) && number.test(b) ? Number(a) - Number(b) : collator.compare(a, b);
}

function sortTable(table, heading) {
  const falling = heading.getAttribute("aria-sort") === "ascending";
  const column = heading.cellIndex;
  const body = table.tBodies[0];
  const keyed = Array.from(body.rows, (row) => [sortValue(row, column), row]);
  keyed.sort(([a], [b]) => {
    if (a === "" || b === "") return (a === "") - (b === "");
    return falling ? compare(b, a) : compare(a, b);
  });
  for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
  heading.setAttribute("aria-sort", falling ? "descending" : "ascending");
  body.append(...keyed.map(([, row]) => row));
}

for (const table of document.querySelectorAll("table.sortable")) {
  if (table.tBodies.length === 0 || table.tBodies[0].rows.length < 2) continue;
  for (const heading of table.tHead.rows[table.tHead.rows.length - 1].cells) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    button.addEventListener("click", () => sortTable(table, heading));
    heading.append(button);
  }
}

// The claims can be narrowed down by verdict, protocol and text.
for (const form of document.querySelectorAll("form.filter")) {
  const rows = Array.from(form.parentElement.querySelector("tbody").rows);
  const apply = () => {
    const { word, column, text } = form.elements;
    const sought = text.value.trim().toLowerCase();
    for (const row of rows) {
      const cells = column.value ? [row.cells[column.value]] : Array.from(row.cells).slice(1);
      const said = cells.some((cell) => cell.querySelector(".badge")?.textContent === word.value);
      row.hidden = (word.value !== "" && !said) || !row.textContent.toLowerCase().includes(sought);
    }
    const shown = rows.filter((row) => !row.hidden).length;
    form.querySelector("output").textContent = `${shown} of ${rows.length} shown`;
  };
  form.addEventListener("input", (event) => {
    if (event.target.name !== "open") return apply();
    for (const row of rows) for (const fold of row.querySelectorAll("details")) fold.open = event.target.checked;
  });
  form.addEventListener("submit", (event) => event.preventDefault());
  form.hidden = false;
  apply();
}
