// Curvature labels on a surface, by thresholds and noise.
{
  const { make, show, tool, normals } = tryIt.ui;
  const { surfaceCurvature, hkLabels } = tryIt.curvature;
  const SIDE = 80, PITCH = 5, SEED = 1988; // points a side, and their distance in µm
  const MILLI = 1000; // 1/µm in 1/mm
  const NOISE = normals(SIDE * SIDE, SEED);
  // Table 3.1, in the colors of chapter 3.
  const TYPES = [
    ["unknown (border)", "#ffffff"], ["convex elliptic", "#08519c"], ["convex cylindric", "#4292c6"],
    ["saddle ridge", "#9ecae1"], ["none: H = 0, K > 0", "#000000"], ["planar", "#d9d9d9"],
    ["minimal surface", "#009e73"], ["concave elliptic", "#993404"], ["concave cylindric", "#ec7014"],
    ["saddle valley", "#fec44f"],
  ];
  // Heights in µm at (x, y) in µm from the middle; the map is 395 µm wide.
  const SURFACES = {
    "Ball on a plane": (x, y) => Math.max(Math.sqrt(Math.max(150 ** 2 - x * x - y * y, 0)) - 60, 0),
    "Parabolic cylinder": (x) => 80 * Math.max(1 - (x / 130) ** 2, 0),
    "Saddle": (x, y) => (x * x - y * y) / 400,
    "Egg box": (x, y) => 20 * Math.cos(x / 35) * Math.cos(y / 35),
  };

  const heights = (surface) =>
    Float64Array.from({ length: SIDE * SIDE }, (_, i) =>
      SURFACES[surface](((i % SIDE) - (SIDE - 1) / 2) * PITCH, (Math.floor(i / SIDE) - (SIDE - 1) / 2) * PITCH));

  const paint = (canvas, colorOf) => {
    const context = canvas.getContext("2d");
    const image = context.createImageData(SIDE, SIDE);
    for (let i = 0; i < SIDE * SIDE; i++) image.data.set([...colorOf(i), 255], 4 * i);
    context.putImageData(image, 0, 0);
  };
  const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
  // Light from the upper left, as maps have it.
  const shade = (map) => (i) => {
    const right = map[i % SIDE < SIDE - 1 ? i + 1 : i], below = map[i + SIDE < SIDE * SIDE ? i + SIDE : i];
    const slopes = [(right - map[i]) / PITCH, (below - map[i]) / PITCH];
    const light = (0.75 + 0.5 * slopes[0] + 0.5 * slopes[1]) / Math.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2);
    return new Array(3).fill(Math.max(20, Math.min(250, 250 * light)));
  };

  let errors = [0, 0];
  const update = ({ noise, size, hZero, kZero }) => {
    if (!(noise >= 0 && hZero >= 0 && kZero >= 0 && size >= 3 && size <= 31 && size % 2 === 1)) {
      answer.replaceChildren("Noise and thresholds must not be negative, and the window must be odd, from 3 to 31 px.");
      return;
    }
    const map = heights(choice.value).map((z, i) => z + noise * NOISE[i]);
    const curvature = surfaceCurvature(map, SIDE, SIDE, PITCH, size, noise);
    const labels = hkLabels(curvature.mean, curvature.gaussian, hZero / MILLI, kZero / MILLI ** 2);
    const middle = (field) => field.filter((v) => !Number.isNaN(v)).sort()[Math.floor((SIDE - 2 * size) ** 2 / 2)];
    errors = [middle(curvature.meanUncertainty) * MILLI, middle(curvature.gaussianUncertainty) * MILLI ** 2];
    answer.replaceChildren(
      `The noise gives H a median standard error of ${show(errors[0])} 1/mm, and K a median standard error of ` +
        `${show(errors[1])} 1/mm². With thresholds below two or three standard errors, noise is labeled as shape.`);
    paint(relief, shade(map));
    paint(types, (i) => rgb(TYPES[labels[i]][1]));
    const counts = TYPES.map((_, label) => labels.filter((one) => one === label).length);
    const known = SIDE * SIDE - counts[0];
    const shares = counts.flatMap((count, label) =>
      label && count ? [[label, `${TYPES[label][0]} ${show((100 * count) / known)} %`]] : []);
    types.setAttribute("aria-label", `Surface types: ${shares.map(([, text]) => text).join(", ")}`);
    legend.replaceChildren(...shares.map(([label, text]) =>
      make("li", {}, make("span", { class: "try-swatch", style: `background: ${TYPES[label][1]}` }), text)));
  };

  const answer = make("output", { class: "try-answer" });
  const canvas = (says) => make("canvas", { width: SIDE, height: SIDE, role: "img", "aria-label": says });
  const relief = canvas("The surface with its noise, shaded"), types = canvas("Surface types");
  const legend = make("ul", { class: "try-key", "aria-label": "Surface types and their shares" });
  const choice = make("select", { id: "try-surface-shape" }, ...Object.keys(SURFACES).map((name) => make("option", {}, name)));
  const { place, form, refresh, button, byName } = tool("surface", [
    { name: "noise", label: "Noise of the heights", unit: "µm", min: 0, max: 3, step: 0.05, value: 0.3 },
    { name: "size", label: "Window", unit: "px", min: 3, max: 15, step: 2, value: 7 },
    { name: "hZero", label: "Threshold ε of H", unit: "1/mm", min: 0, max: 10, step: 0.05, value: 1 },
    { name: "kZero", label: "Threshold ε of K", unit: "1/mm²", min: 0, max: 50, step: 0.25, value: 8 },
  ], (values) => update(values));
  form.prepend(make("div", { class: "try-control" }, make("label", { for: choice.id }, "Surface"), choice));
  choice.addEventListener("change", refresh);
  button("Set both thresholds to three standard errors", () => {
    byName.hZero.set(Number((3 * errors[0]).toPrecision(3)));
    byName.kZero.set(Number((3 * errors[1]).toPrecision(3)));
  });
  const figure = (one, text) => make("figure", {}, one, make("figcaption", {}, text));
  place.append(answer, make("div", { class: "try-pictures" }, figure(relief, "Shaded"), figure(types, "Surface types")), legend);
  refresh();
}
