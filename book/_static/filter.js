// Narrow the table of claims by a word and a verdict.
{
  const form = document.querySelector(".claims-filter");
  if (form) {
    const rows = [...document.querySelectorAll("table.claims tbody tr")];
    const verdict = (row) => row.lastElementChild.textContent.trim();
    const text = form.querySelector("[data-claims-text]");
    const select = form.querySelector("[data-claims-verdict]");
    const count = form.querySelector("[data-claims-count]");
    for (const name of new Set(rows.map(verdict))) select.add(new Option(name, name));
    const narrow = () => {
      const word = text.value.toLowerCase();
      for (const row of rows) {
        const fits = row.textContent.toLowerCase().includes(word);
        row.hidden = !fits || (select.value && verdict(row) !== select.value);
      }
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
    };
    text.addEventListener("input", narrow);
    select.addEventListener("change", narrow);
    narrow();
  }
}
