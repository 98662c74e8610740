// Narrow the table of claims by a word, a verdict, what was spent, and a kind.
{
  const form = document.querySelector(".claims-filter");
  if (form) {
    const rows = [...document.querySelectorAll("table.claims tbody tr")];
    const text = form.querySelector("[data-claims-text]");
    const choices = [["verdict", "has"], ["spent", "spent"], ["kind", "kind"]].map(([name, prefix]) => [
      form.querySelector(`[data-claims-${name}]`),
      (row) => new RegExp(`${prefix}-(\\w+)`).exec(row.className)[1],
    ]);
    const count = form.querySelector("[data-claims-count]");
    for (const [select, sort] of choices)
      for (const name of new Set(rows.map(sort))) select.add(new Option(name, name));
    const narrow = () => {
      const word = text.value.toLowerCase();
      for (const row of rows) {
        const fits = row.textContent.toLowerCase().includes(word);
        const chosen = choices.every(([s, sort]) => !s.value || sort(row) === s.value);
        row.hidden = !fits || !chosen;
      }
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
    };
    text.addEventListener("input", narrow);
    for (const [select] of choices) select.addEventListener("change", narrow);
    narrow();
  }
}
