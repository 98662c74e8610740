// A focal stack under the pointer: the focus measure over the frames, and its peak.
{
  const { make, show, tool, plot } = tryIt.ui;
  const { sumModifiedLaplacian, gaussianPeak } = tryIt.focus;
  const { rows, cols, positions, truth, data } = tryIt.stack;
  const frames = data.map((text) => ({ rows, cols, pixels: Uint8Array.from(atob(text), (c) => c.charCodeAt(0)) }));

  const paint = (canvas, level) => {
    const context = canvas.getContext("2d");
    const image = context.createImageData(cols, rows);
    for (let i = 0; i < rows * cols; i++) image.data.set([level(i), level(i), level(i), 255], 4 * i);
    context.putImageData(image, 0, 0);
    return context;
  };
  const mark = (context, x, y) => {
    for (const [color, width] of [["#000", 3], ["#fff", 1]]) {
      context.strokeStyle = color;
      context.lineWidth = width;
      context.strokeRect(x - 2.5, y - 2.5, 6, 6); // the window of the measure and its reach
    }
  };

  const update = ({ frame, x, y }) => {
    const inside = (value, count) => Math.max(0, Math.min(count - 1, Math.round(value) || 0));
    const [k, u, v] = [inside(frame, frames.length), inside(x, cols), inside(y, rows)];
    mark(paint(view, (i) => frames[k].pixels[i]), u, v);
    const profile = frames.map((one) => sumModifiedLaplacian(one, u, v));
    peak = gaussianPeak(profile, positions);
    answer.replaceChildren(
      make("strong", {}, `Height ${show(peak.depth)} µm`),
      ` at column ${u}, row ${v}. The true height is ${show(truth[v * cols + u])} µm. The frame that is shown is focused at ` +
        `${show(positions[k])} µm. The sharpest frame at the mark is focused at ${show(positions[peak.index])} µm.`);
    const top = 1.1 * Math.max(...profile);
    chart.replaceChildren(plot(chart.clientWidth || 340, {
      x: [positions[0], positions.at(-1)], y: [0, top], xLabel: "position of the frame (µm)", yLabel: "focus measure",
      says: `The focus measure over the frames; its peak is at ${show(peak.depth)} µm`,
      lines: [
        { points: [[positions[k], 0], [positions[k], top]], kind: "wanted" },
        { points: [[peak.depth, 0], [peak.depth, top]], kind: "second" },
        { points: profile.map((value, n) => [positions[n], value]), kind: "first" },
        { points: profile.map((value, n) => [positions[n], value]), kind: "first", dots: true },
      ],
    }));
  };

  let peak = { index: 0 };
  const answer = make("output", { class: "try-answer" });
  const view = make("canvas", { width: cols, height: rows, role: "img", class: "try-drag",
    "aria-label": "One frame of the stack; the sliders for column and row move the mark, and so does dragging" });
  const map = make("canvas", { width: cols, height: rows, role: "img",
    "aria-label": "The height of every pixel from the stack, dark is low: a dome" });
  const chart = make("div", { class: "try-picture" });
  const { place, refresh, button, byName } = tool("focus", [
    { name: "frame", label: "Frame", unit: "", min: 0, max: frames.length - 1, step: 1, value: 3 },
    { name: "x", label: "Column", unit: "px", min: 0, max: cols - 1, step: 1, value: Math.floor(cols / 3) },
    { name: "y", label: "Row", unit: "px", min: 0, max: rows - 1, step: 1, value: Math.floor(rows / 3) },
  ], (values) => update(values));
  button("Go to the sharpest frame here", () => byName.frame.set(peak.index));
  const point = (event) => {
    const box = view.getBoundingClientRect();
    byName.x.set(Math.max(0, Math.min(cols - 1, Math.floor(((event.clientX - box.left) / box.width) * cols))));
    byName.y.set(Math.max(0, Math.min(rows - 1, Math.floor(((event.clientY - box.top) / box.height) * rows))));
    refresh();
  };
  view.addEventListener("pointerdown", (event) => {
    view.setPointerCapture(event.pointerId);
    point(event);
  });
  view.addEventListener("pointermove", (event) => event.buttons && point(event));
  const figure = (one, text) => make("figure", {}, one, make("figcaption", {}, text));
  place.append(answer, make("div", { class: "try-pictures" }, figure(view, "One frame; drag the mark"), figure(map, "Heights from all frames")), chart);
  refresh();
  // Every pixel takes a fifth of a second: after the page is there.
  setTimeout(() => {
    const span = positions.at(-1) - positions[0];
    const depths = Array.from({ length: rows * cols }, (_, i) =>
      gaussianPeak(frames.map((one) => sumModifiedLaplacian(one, i % cols, Math.floor(i / cols))), positions).depth);
    paint(map, (i) => 255 * ((depths[i] - positions[0]) / span));
  }, 0);
}
