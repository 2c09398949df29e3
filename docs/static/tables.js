// Sort and filter tables of class "sortable". Without this script they are plain tables.
"use strict";

const BLANK = ["", "–"];
const text = (row, column) => row.cells[column].textContent.trim();

function element(tag, properties) {
  return Object.assign(document.createElement(tag), properties);
}

function isNumeric(rows, column) {
  return rows.every((row) => BLANK.includes(text(row, column)) || /^-?\d/.test(text(row, column)));
}

function addSorting(table, rows) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const numeric = isNumeric(rows, column);
    const value = (row) => (numeric ? parseFloat(text(row, column)) : text(row, column));
    const compare = (a, b) => (numeric ? value(a) - value(b) : value(a).localeCompare(value(b)));
    const button = element("button", { type: "button", title: "Sort by this column" });
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => {
      const order = heading.getAttribute("aria-sort") === "ascending" ? "descending" : "ascending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", order);
      const blank = rows.filter((row) => BLANK.includes(text(row, column)));
      const others = rows.filter((row) => !blank.includes(row));
      others.sort((a, b) => (order === "ascending" ? compare(a, b) : compare(b, a)));
      table.tBodies[0].append(...others, ...blank);
    });
  });
}

function addFilters(table, rows) {
  const filters = element("div", { className: "table-filters" });
  const shown = element("output");
  const lists = [];
  [...table.tHead.rows[0].cells].forEach((heading, column) => {
    const values = [...new Set(rows.map((row) => text(row, column)))];
    if (isNumeric(rows, column) || values.length < 2 || values.length === rows.length) return;
    const label = element("label", { textContent: `${heading.textContent.trim()} ` });
    const list = element("select");
    list.append(element("option", { value: "", textContent: "all" }));
    values.sort((a, b) => a.localeCompare(b)).forEach((value) => list.append(element("option", { value, textContent: value })));
    label.append(list);
    filters.append(label);
    lists.push([column, list]);
  });
  if (!lists.length) return;
  const update = () => {
    rows.forEach((row) => {
      row.hidden = lists.some(([column, list]) => list.value && list.value !== text(row, column));
    });
    shown.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  };
  filters.addEventListener("change", update);
  filters.append(shown);
  const box = table.closest(".table-wrapper") || table;
  box.before(filters);
  update();
}

document.querySelectorAll("table.sortable").forEach((table) => {
  const rows = [...table.tBodies[0].rows];
  addFilters(table, rows);
  addSorting(table, rows);
});
