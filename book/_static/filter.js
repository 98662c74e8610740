// Narrow the list of claims by a word and by what each is; the choice stands in the address.
addEventListener("DOMContentLoaded", () => {
  const facets = document.getElementById("claims-facets");
  if (!facets) return;
  const known = JSON.parse(facets.textContent);
  const rows = [...document.querySelectorAll("table.claims tbody tr")];
  const form = Object.assign(document.createElement("div"), { className: "claims-filter" });
  const count = document.createElement("output");
  const titles = { text: "Find", verdict: "Verdict", part: "Part" };
  const fields = Object.entries(titles).map(([name, title]) => {
    const field = document.createElement(name === "text" ? "input" : "select");
    field.name = name;
    if (name === "text") field.type = "search";
    else {
      const values = [...new Set(rows.map((row) => known[row.id][name]))];
      if (name === "part") values.sort(); // the rows are ordered by verdict
      for (const value of ["", ...values]) field.add(new Option(value || "all", value));
    }
    const label = document.createElement("label");
    label.append(`${title} `, field);
    form.append(label);
    return field;
  });
  form.append(count);
  facets.after(form);
  const narrow = () => {
    const chosen = fields.filter((field) => field.value).map((field) => [field.name, field.value]);
    for (const row of rows)
      row.hidden = !chosen.every(([name, value]) =>
        name === "text" ? row.textContent.toLowerCase().includes(value.toLowerCase()) : known[row.id][name] === value);
    count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length}`;
    const query = new URLSearchParams(chosen).toString();
    history.replaceState(null, "", `${location.pathname}${query && `?${query}`}${location.hash}`);
  };
  for (const [name, value] of new URLSearchParams(location.search)) {
    const field = fields.find((one) => one.name === name);
    if (field) field.value = value;
  }
  for (const field of fields) field.addEventListener("input", narrow);
  narrow();
});
