// Hover, focus or a tap on a recomputed number shows its card; on paper a footnote holds the same.
addEventListener("DOMContentLoaded", () => {
  if (!globalThis.numberCards) return; // no page without a number has them
  const root = document.documentElement.dataset.content_root;
  const make = (tag, properties, ...children) => {
    const one = Object.assign(document.createElement(tag), properties);
    one.append(...children);
    return one;
  };
  const NUMBERS = "article a:is([href*='#number-'], [href*='--number-'], table.as-printed *)";
  const cardOf = (link) => numberCards[/(?:#|--)(?:number|claim)-(.+)$/.exec(link?.hash)?.[1]];

  // An index such as that of T_z stands below the line.
  const write = (text) => text.split(/(?<=(?<![\p{L}\d_])\p{L})_([xy]{2}|op|[a-z])\b/u).map((part, k) => (k % 2 ? make("sub", { textContent: part }) : part));

  const tell = ({ title, label, rows }) => {
    const list = make("dl", {});
    for (const [name, text, address] of rows) {
      const told = address ? [make("a", { href: root + address, textContent: text })] : name === "Made by" ? [make("pre", { textContent: text })] : write(text);
      if (name === "Verdict") told[0].className = `verdict verdict-${label}`;
      list.append(make("dt", { textContent: name }), make("dd", {}, ...told));
    }
    return [make("p", { className: "card-title" }, ...write(title)), list];
  };

  const card = make("div", { id: "number-card", className: "number-card", popover: "manual", role: "group", ariaLabel: "What is known of this number" });
  let shown, timer, finger;
  const hide = () => {
    clearTimeout(timer);
    shown?.removeAttribute("aria-describedby");
    shown = undefined;
    card.remove();
  };
  const show = (link) => {
    hide();
    shown = link;
    card.replaceChildren(...tell(cardOf(link)));
    card.querySelector("dl").id = "number-card-told";
    link.removeAttribute("title"); // or the browser would show it, too
    link.setAttribute("aria-describedby", "number-card-told");
    link.after(card); // so that the next stop of the tabulator is in the card
    card.showPopover();
    // Below the number, or above it where there is more room.
    const { left, top, bottom } = link.getClientRects()[0];
    const below = innerHeight - bottom > Math.min(top, card.offsetHeight + 8);
    card.style.maxHeight = `${(below ? innerHeight - bottom : top) - 12}px`;
    card.style.left = `${scrollX + Math.max(8, Math.min(left, document.body.clientWidth - card.offsetWidth - 8))}px`;
    card.style.top = `${scrollY + (below ? bottom + 4 : top - card.offsetHeight - 4)}px`;
  };
  // The number that a part of the page belongs to: it is one, or the card of one.
  const numberAt = (part) => {
    if (card.contains(part)) return shown;
    const link = part.closest?.(NUMBERS);
    return cardOf(link) && link;
  };

  document.addEventListener("pointerover", ({ target, pointerType }) => {
    const link = numberAt(target), kept = numberAt(document.activeElement) === shown;
    clearTimeout(timer);
    if (pointerType === "touch" || link === shown || (!link && kept)) return;
    timer = setTimeout(() => (link ? show(link) : hide()), link ? 150 : 300);
  });
  document.addEventListener("focusin", ({ target }) => {
    const link = numberAt(target);
    if (link === shown) return;
    if (link && target.matches(":focus-visible")) show(link);
    else hide();
  });
  document.addEventListener("keydown", ({ key }) => {
    if (key !== "Escape") return;
    if (card.contains(document.activeElement)) shown.focus();
    hide();
  });
  document.addEventListener("pointerdown", ({ pointerType }) => (finger = pointerType === "touch"));
  document.addEventListener("click", (event) => {
    const link = numberAt(event.target);
    if (link === shown) return; // the second tap follows the link
    if (!link) return hide();
    if (!finger) return;
    event.preventDefault();
    show(link);
  });

  // A note stands behind the section that mentions its number first.
  addEventListener("beforeprint", () => {
    for (const page of document.querySelectorAll(".printed-page, article:not(:has(.printed-page))")) {
      const notes = [];
      for (const link of page.querySelectorAll(NUMBERS)) {
        const told = cardOf(link);
        if (!["contradicts", "open"].includes(told?.label) || link.closest("table:is(.claims, .ledger)")) continue;
        if (!notes.includes(told)) {
          const place = link.closest(":is(article, .printed-page) > section > section") ?? page;
          const number = notes.push(told);
          let list = place.querySelector(":scope > .card-notes");
          if (!list) place.append((list = make("ol", { className: "card-notes", start: number })));
          const note = make("li", {}, ...tell(told));
          for (const lead of note.querySelectorAll("a")) lead.replaceWith(lead.textContent);
          list.append(note);
        }
        link.after(make("sup", { className: "card-mark", textContent: notes.indexOf(told) + 1 }));
      }
    }
  }, { once: true });
});
