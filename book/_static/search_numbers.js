// The book writes "HK"; a search for "H–K" or "H-K" would look for the letters H and K.
{
  const address = new URL(location.href), query = address.searchParams.get("q") ?? "";
  address.searchParams.set("q", query.replace(/H[–-]K/gi, "HK"));
  if (address.searchParams.get("q") !== query) history.replaceState(null, "", address);
}

// On the search page, put what "5.6", "equation 4.7", "fig. 3.2" or "1.3237" leads to before the other results.
// Kind, text and address of all that a query may mean; nothing for "4X", "3-D" or "16 frames".
globalThis.findNumber = query => {
  const kinds = { sec: "section", ch: "section", eq: "equation", fig: "figure", tab: "table" };
  const asked = /(?:\b(sec|ch|eq|fig|tab)[a-z]*\.?\s*|(?<![\w.]))\(?([−-]?\d+(?:\.\d+)*(?:e[+-]?\d+)?)(?!\.?[\w-])/i.exec(query);
  const kind = kinds[asked?.[1]?.toLowerCase()];
  const number = asked?.[2].replace("−", "-") ?? "";
  const places = /^-?\d*\.(\d+)$/.exec(number)?.[1].length;
  // "1.32" and "1.324" stand for 1.3237, too: what begins with them, and what is rounded to them.
  const near = ([other]) => other !== number && (other.startsWith(number) || Math.abs(other - number) <= 0.5001 / 10 ** places);
  const values = places ? Object.entries(thesisNumbers).filter(near).flatMap(([, entries]) => entries.filter(([one]) => one === "value")) : [];
  // Claims without a number in the thesis come last.
  const unprinted = ([, text]) => text.includes("printed no number");
  values.sort((one, other) => unprinted(one) - unprinted(other));
  const all = [...(thesisNumbers[number] ?? []), ...values];
  // Of values, those with the unit that follows the number, if one does.
  const unit = /\d\s*(µm|mm|px|MPa|µN|s|%|°)(?!\p{L})/u.exec(query)?.[1] ?? "";
  const same = all.filter(([one, text]) => one !== "value" || text.includes(` ${unit}`));
  const found = [...new Map(same.map((entry) => [entry[2], entry])).values()];
  // A whole number alone, as in "16 frames", is no question for a value.
  const whole = /^\d+$/.test(asked?.[2] ?? "") && asked[2] !== query.trim();
  return found.filter(([one]) => (kind ? one === kind : !(whole && one === "value")));
};

addEventListener("DOMContentLoaded", () => {
  const results = document.getElementById("search-results");
  if (!results || !globalThis.thesisNumbers) return;
  // The numbers of claims are on their cards.
  for (const [name, { title, label, rows }] of Object.entries(numberCards)) {
    const { Printed: printed, Recomputed: found } = Object.fromEntries(rows);
    const text = `${title}: printed ${printed}${found ? `, recomputed ${found}` : ""}: ${label}`;
    const numbers = label === "result" ? [] : `${printed} ${found ?? ""}`.match(/-?\d[\d.]*(?:e[+-]?\d+)?/g);
    for (const number of new Set(numbers)) (thesisNumbers[number] ??= []).push(["value", text, `claims.html#claim-${name}`]);
  }
  const found = findNumber(new URLSearchParams(location.search).get("q") ?? "");
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
  // Sphinx, which knows no numbers, would say that nothing was found.
  const mend = () => {
    for (const text of document.querySelectorAll("#search-results p.search-summary, #search-results > p"))
      text.hidden = !document.querySelector("#search-results ul.search li");
  };
  new MutationObserver(mend).observe(results, { childList: true, subtree: true });
  mend();
});
