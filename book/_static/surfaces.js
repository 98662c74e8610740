// 3-D figures: a picture first. A click loads plotly's library and puts the surface in its place.
addEventListener("DOMContentLoaded", () => {
  const root = new URL(document.documentElement.dataset.content_root ?? "./", location.href);
  let library;
  const load = () =>
    (library ??= new Promise((done) => {
      const src = new URL("_static/plotly.min.js", root);
      document.head.append(Object.assign(document.createElement("script"), { src, onload: done }));
    }));

  // The surface has the colors of the page, and on a phone texts as large as the page's.
  const paint = (figure) => {
    const style = getComputedStyle(document.documentElement);
    const color = (name) => style.getPropertyValue(`--pst-color-${name}`);
    const change = { paper_bgcolor: color("background"), "font.color": color("text-base") };
    for (const axis of ["xaxis", "yaxis", "zaxis"])
      Object.assign(change, { [`scene.${axis}.gridcolor`]: color("border"), [`scene.${axis}.zerolinecolor`]: color("border"),
        [`scene.${axis}.backgroundcolor`]: color("background"),
        ...(innerWidth < 600 ? { [`scene.${axis}.tickfont.size`]: 16, [`scene.${axis}.nticks`]: 3 } : {}) });
    Plotly.relayout(figure, change);
    if (innerWidth < 600) Plotly.restyle(figure, { showscale: Boolean(figure.data[0].colorbar?.ticktext) });
  };

  for (const box of document.querySelectorAll(".surface")) {
    const [picture, button, template] = ["img", "button", "template"].map((name) => box.querySelector(name));
    const said = button.textContent;
    let figure;
    button.addEventListener("click", async () => {
      await load();
      if (figure) {
        figure.remove();
        figure = undefined;
      } else {
        Plotly.setPlotConfig({ displayModeBar: false });
        box.append(template.content.cloneNode(true)); // its script draws
        figure = box.lastElementChild;
        const drawn = figure.querySelector(".plotly-graph-div");
        // The wheel belongs to the page; plotly would take it whether it zooms or not.
        drawn.addEventListener("wheel", (event) => event.stopPropagation(), { capture: true, passive: true });
        paint(drawn);
        new MutationObserver(() => drawn.isConnected && paint(drawn)).observe(document.documentElement, { attributeFilter: ["data-theme"] });
      }
      picture.hidden = Boolean(figure);
      button.textContent = figure ? "Back to the picture" : said;
    });
  }
});
