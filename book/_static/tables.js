// On a phone each row of a table with four columns or more is a card; its cells name their columns.
addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("article table")) {
    const heads = table.tHead?.rows.length === 1 ? [...table.tHead.rows[0].cells].map((cell) => cell.textContent.trim()) : [];
    if (heads.length < 4) continue;
    table.classList.add("labeled");
    for (const row of table.tBodies[0].rows)
      [...row.cells].forEach((cell, k) => k && (cell.dataset.head = heads[k]));
  }
});
