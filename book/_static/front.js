// The figure of the front page shows for each choice what the library computed when the book was built.
addEventListener("DOMContentLoaded", () => {
  const figure = document.querySelector(".front-figure");
  if (!figure) return;
  const states = JSON.parse(figure.querySelector("script").textContent);
  const form = figure.querySelector("form");
  const part = (name) => figure.querySelector(`[data-part=${name}]`);
  const show = () => {
    const { rim, model, width } = Object.fromEntries(new FormData(form));
    const state = states[`${rim} ${model} ${Number(width)}`];
    part("model").setAttribute("d", state.path);
    part("probe").setAttribute("x", state.x);
    part("probe").setAttribute("width", state.width);
    part("found").style.visibility = state.at === null ? "hidden" : "";
    part("found").setAttribute("cx", state.at ?? 0);
    for (const side of ["left", "right"]) part(side).classList.toggle("taken", side === state.rim);
    part("band").style.visibility = state.band === null ? "hidden" : "";
    if (state.band) {
      part("band").querySelector("rect").setAttribute("x", state.band.x);
      part("band").querySelector("rect").setAttribute("width", state.band.width);
      part("band").querySelector("text").textContent = state.band.text;
    }
    figure.querySelector(".told").textContent = state.text;
    figure.querySelector("output").textContent = Number(width);
    form.elements.width.setAttribute("aria-valuetext", `${Number(width)} µm`);
  };
  form.hidden = false;
  form.addEventListener("input", show);
  form.addEventListener("submit", (event) => event.preventDefault());
  show();
});
