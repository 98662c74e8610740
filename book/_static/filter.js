// Narrow the list of claims by a word and by what each is; the choice stands in the address.
{
  const facets = document.getElementById("claims-facets");
  if (facets) {
    const known = JSON.parse(facets.textContent);
    const rows = [...document.querySelectorAll("table.claims tbody tr")];
    const fields = [...document.querySelectorAll("[data-claims]")];
    const count = document.querySelector("[data-claims-count]");
    for (const field of fields.filter((one) => one.tagName === "SELECT"))
      for (const name of new Set(rows.map((row) => known[row.id][field.dataset.claims]))) field.add(new Option(name, name));
    const narrow = () => {
      const chosen = fields.filter((field) => field.value).map((field) => [field.dataset.claims, field.value]);
      for (const row of rows)
        row.hidden = !chosen.every(([name, value]) =>
          name === "text" ? row.textContent.toLowerCase().includes(value.toLowerCase()) : known[row.id][name] === value);
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
      const query = new URLSearchParams(chosen).toString();
      history.replaceState(null, "", `${location.pathname}${query && `?${query}`}${location.hash}`);
    };
    for (const [name, value] of new URLSearchParams(location.search)) {
      const field = fields.find((one) => one.dataset.claims === name);
      if (field) field.value = value;
    }
    for (const field of fields) field.addEventListener("input", narrow);
    narrow();
  }
}
