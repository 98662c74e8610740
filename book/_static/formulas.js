// Shrink a display formula that is wider than its column, so that none has to be scrolled.
{
  const fit = (part) => {
    for (const formula of part.querySelectorAll("div.math mjx-container[display]")) {
      const column = formula.closest("div.math");
      const needed = () => Math.max(column.scrollWidth, formula.scrollWidth);
      formula.style.fontSize = formula.style.overflowX = column.style.overflowX = "";
      // The distance to the number does not shrink with the formula: look again.
      for (let look = 0, size = 1; look < 6 && needed() > column.clientWidth; look++) {
        size *= (column.clientWidth - 1) / needed();
        formula.style.fontSize = `${Math.floor(size * 1000) / 10}%`;
      }
      // The boxes of glyphs reach a little past what is drawn; that is no reason to scroll.
      formula.style.overflowX = column.style.overflowX = "clip";
    }
  };
  // The cell that a recomputed number leads to opens.
  const open = () => {
    const aim = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!aim?.id?.startsWith("number-")) return aim;
    const cell = aim.closest(".cell");
    for (const fold of cell.querySelectorAll("details")) fold.open = true;
    return cell;
  };
  addEventListener("DOMContentLoaded", open);
  addEventListener("hashchange", () => open()?.scrollIntoView({ behavior: "instant" }));
  const start = async () => {
    await window.MathJax?.startup?.promise;
    fit(document);
    globalThis.formulasFit = true;
    // What is drawn late moves the page: go to the anchor again, unless the reader has moved.
    const aim = open();
    if (aim && !moved) aim.scrollIntoView({ behavior: "instant" });
    let width = innerWidth;
    addEventListener("resize", () => {
      if (innerWidth !== width) fit(document); // not when a phone's address bar comes and goes
      width = innerWidth;
    });
    // What was folded away had no width; what stands above it must not move.
    for (const fold of document.querySelectorAll("details")) fold.addEventListener("toggle", () => fit(fold));
  };
  let moved = false;
  for (const kind of ["wheel", "touchmove", "keydown", "mousedown"])
    addEventListener(kind, () => (moved = true), { once: true, passive: true });
  addEventListener("load", start);
}
