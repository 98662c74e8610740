// On the search page, put what "5.6", "equation 4.7" or "fig. 3.2" leads to before the other results.
addEventListener("DOMContentLoaded", () => {
  const results = document.getElementById("search-results");
  if (!results || !globalThis.thesisNumbers) return;
  const query = new URLSearchParams(location.search).get("q") ?? "";
  const asked = /(?:(sec|eq|fig|tab|chapter)\w*\.?)?\s*\(?(\d(?:\.\d+)*)\)?/i.exec(query);
  const kind = { sec: "section", eq: "equation", fig: "figure", tab: "table", chapter: "section" }[asked?.[1]?.toLowerCase()];
  const found = (thesisNumbers[asked?.[2]] ?? []).filter(([one]) => !kind || one === kind);
  if (!found.length) return;
  const list = document.createElement("ul");
  list.className = "search number-results";
  for (const [, text, address] of found) {
    const link = Object.assign(document.createElement("a"), { href: address, textContent: text });
    const item = document.createElement("li");
    item.append(link);
    list.append(item);
  }
  results.before(list);
});
