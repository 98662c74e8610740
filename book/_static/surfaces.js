// 3-D figures: a page is scrolled over them, by wheel and finger, and they follow its colors.
addEventListener("load", () => {
  const figures = [...document.querySelectorAll(".plotly-graph-div")];
  if (!figures.length) return;

  const paint = () => {
    const style = getComputedStyle(document.documentElement);
    const text = style.getPropertyValue("--pst-color-text-base"), ground = style.getPropertyValue("--pst-color-background");
    const lines = style.getPropertyValue("--pst-color-border");
    for (const figure of figures) {
      const change = { paper_bgcolor: ground, "font.color": text };
      for (const scene of Object.keys(figure._fullLayout ?? {}).filter((key) => /^scene\d*$/.test(key)))
        for (const axis of ["xaxis", "yaxis", "zaxis"])
          Object.assign(change, { [`${scene}.${axis}.gridcolor`]: lines, [`${scene}.${axis}.backgroundcolor`]: ground,
            [`${scene}.${axis}.zerolinecolor`]: lines });
      Plotly.relayout(figure, change);
    }
  };
  paint();
  new MutationObserver(paint).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });

  // On a phone texts are as large as the page's, and the eye further back, so that no axis is cut. Colors that repeat the
  // heights, which an axis has, need no scale.
  if (innerWidth < 600)
    for (const figure of figures) {
      const eye = figure._fullLayout?.scene?.camera?.eye;
      if (!eye) continue;
      Plotly.restyle(figure, { "colorbar.thickness": 10, showscale: Boolean(figure.data[0].colorbar?.ticktext) });
      const title = figure._fullLayout.title.text.replace(/(.{1,30})(\s|$)/g, "$1<br>").replace(/<br>$/, "");
      const change = { "font.size": 16, "title.font.size": 18, "title.text": title, "margin.t": 60,
        "scene.camera.eye": { x: 1.75 * eye.x, y: 1.75 * eye.y, z: 1.75 * eye.z } };
      for (const axis of ["xaxis", "yaxis", "zaxis"])
        Object.assign(change, { [`scene.${axis}.tickfont.size`]: 16, [`scene.${axis}.nticks`]: 3 });
      Plotly.relayout(figure, change);
    }

  // The wheel belongs to the page; plotly would take it whether it zooms or not.
  for (const figure of figures)
    figure.addEventListener("wheel", (event) => event.stopPropagation(), { capture: true, passive: true });

  // A finger scrolls the page until it is told to turn the figure.
  for (const figure of figures) {
    const button = document.createElement("button");
    const write = (turning) => {
      button.textContent = turning ? "Done turning" : "Turn the surface by finger";
      button.setAttribute("aria-pressed", turning);
    };
    button.type = "button";
    button.className = "turn-surface";
    button.addEventListener("click", () => write(figure.classList.toggle("turning")));
    write(false);
    figure.parentElement.before(button); // the parent has the height of the figure alone
  }
});
