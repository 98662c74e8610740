// From a force and a dimple to a modulus, with the dimple drawn to scale.
{
  const { make, draw, show, tool } = tryIt.ui;
  const { STEEP, refusal, elasticModulus, modulusStd, dimpleProfile } = tryIt.membrane;
  // Table 5.6, with the half-width that the printed modulus implies.
  const INPUTS = [
    ["force", "Force F", "µN", 1, 500, 0.01, 197.24],
    ["rimRadius", "Rim radius a", "µm", 20, 600, 0.01, 246.95],
    ["dimpleDepth", "Dimple depth", "µm", 1, 300, 0.01, 121.22],
    ["probeHalfWidth", "Probe half-width c", "µm", 1, 100, 0.1, 25],
    ["thickness", "Membrane thickness h", "µm", 0.5, 10, 0.1, 3],
    ["poissonRatio", "Poisson ratio ν", "", 0, 0.5, 0.01, 0.5],
  ].map(([name, label, unit, min, max, step, value]) => ({ name, label, unit, min, max, step, value }));
  const LENGTHS = INPUTS.slice(0, 5);
  const ERRORS = LENGTHS.map(({ name, label }) => ({
    name: `${name}Std`, label: `Standard deviation of ${label.split(" ").at(-1)}`, unit: "%",
    min: 0, max: 10, step: 0.1, value: 1,
  }));

  const dimple = (width, p) => {
    const reach = 1.2 * p.rimRadius;
    const scale = width / (2 * reach);
    const rim = 62, deep = Math.min(p.dimpleDepth * scale, 2 * width);
    const height = rim + deep + 40;
    const toX = (r) => width / 2 + r * scale;
    const points = Array.from({ length: 201 }, (_, k) => {
      const r = reach * (k / 100 - 1);
      return `${toX(r).toFixed(1)} ${(rim + Math.min(dimpleProfile(Math.abs(r), p) * scale, deep)).toFixed(1)}`;
    });
    const says = `The dimple in section, to scale: ${show(2 * p.rimRadius)} µm wide, ${show(p.dimpleDepth)} µm deep, ` +
      `under a probe of ${show(2 * p.probeHalfWidth)} µm`;
    const svg = draw("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": says });
    const probe = Math.max(2 * p.probeHalfWidth * scale, 1);
    const line = (x1, y1, x2, y2) => draw("line", { class: "try-measure", x1, y1, x2, y2 });
    const text = (content, x, y, anchor) => draw("text", { x, y, "text-anchor": anchor }, content);
    svg.append(
      draw("rect", { class: "try-probe", x: width / 2 - probe / 2, y: 0, width: probe, height: rim + deep }),
      draw("path", { class: "try-line first", d: `M${points.join("L")}` }),
      line(toX(0), rim + deep + 14, toX(p.rimRadius), rim + deep + 14),
      text(`a = ${show(p.rimRadius)} µm`, toX(p.rimRadius / 2), rim + deep + 32, "middle"),
      line(toX(-p.rimRadius), rim, toX(-p.rimRadius), rim + deep),
      text(`depth ${show(p.dimpleDepth)} µm`, toX(-p.rimRadius) + 6, rim - 10, "start"),
      text(`2c = ${show(2 * p.probeHalfWidth)} µm`, width / 2 + probe / 2 + 8, 16, "start"),
    );
    return svg;
  };

  const say = (p, stds) => {
    const modulus = elasticModulus(p), std = modulusStd(p, stds);
    // No digit that the standard deviation makes meaningless: two of its own are kept.
    const places = std > 0 ? Math.max(0, Math.min(12, 1 - Math.floor(Math.log10(std)))) : 0;
    const write = (value) => (std > 0 ? value.toFixed(places) : show(value));
    return [
      make("strong", {}, `E = ${write(modulus)} ± ${std > 0 ? write(std) : 0} MPa`),
      ` (one standard deviation); 95 %: ${write(modulus - 1.96 * std)} to ${write(modulus + 1.96 * std)} MPa.`,
    ];
  };

  const update = (values) => {
    const p = Object.fromEntries(INPUTS.map(({ name }) => [name, values[name]]));
    const stds = Object.fromEntries(LENGTHS.map(({ name }) => [name, (values[`${name}Std`] / 100) * p[name]]));
    const wrong = refusal(p);
    answer.replaceChildren(...(wrong ? [wrong] : say(p, stds)));
    const steepness = p.dimpleDepth / p.rimRadius;
    const bends = p.dimpleDepth < 2 * p.thickness;
    warning.hidden = Boolean(wrong) || !(bends || steepness > STEEP);
    warning.textContent = bends
      ? "The dimple is less deep than two thicknesses. The formula omits bending, so the modulus is too high."
      : `The depth is ${show(steepness)} of the radius, above ${STEEP}, so the slopes are not small. The functions disc_modulus and capsule_modulus ` +
        "of microlib.membrane assume neither small slopes nor a uniform stress.";
    picture.replaceChildren(...(wrong ? [] : [dimple(picture.clientWidth || 340, p)]));
  };

  const answer = make("output", { class: "try-answer" });
  const warning = make("p", { class: "try-warning", role: "status" });
  const picture = make("div", { class: "try-picture" });
  const { place, form, refresh, byName } = tool("modulus", [...INPUTS, ...ERRORS], update);
  const fold = make("details", {}, make("summary", {}, "Standard deviations of the inputs"));
  fold.append(...ERRORS.map(({ name }) => byName[name].row));
  form.insertBefore(fold, form.querySelector("button"));
  place.append(answer, warning, picture);
  refresh();
}
