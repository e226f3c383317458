// A click on a column's title sorts the table by it, a second click the other way round.
for (const table of document.querySelectorAll("table.sortable")) {
  const titles = [...table.tHead.rows[0].cells];
  titles.forEach((title, column) => title.querySelector("button").addEventListener("click", () => {
    const falls = title.getAttribute("aria-sort") === "ascending";
    const key = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
    const compare = (a, b) => title.classList.contains("number")
      ? parseFloat(key(a)) - parseFloat(key(b)) : key(a).localeCompare(key(b), undefined, {numeric: true});
    const rows = [...table.tBodies[0].rows].sort((a, b) => falls ? compare(b, a) : compare(a, b));
    titles.forEach((each) => each.removeAttribute("aria-sort"));
    title.setAttribute("aria-sort", falls ? "descending" : "ascending");
    table.tBodies[0].append(...rows);
  }));
}
