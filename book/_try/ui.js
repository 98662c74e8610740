// Labeled sliders, and line drawings that take the page's colors: what the four tools share.
{
  const SVG = "http://www.w3.org/2000/svg";

  // An element with attributes and children; `make` is for HTML, `draw` for SVG.
  const fill = (element, attributes, children) => {
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.append(...children);
    return element;
  };
  const make = (tag, attributes = {}, ...children) =>
    fill(document.createElement(tag), attributes, children);
  const draw = (tag, attributes = {}, ...children) =>
    fill(document.createElementNS(SVG, tag), attributes, children);

  // Four digits, without an exponent where it can be read without.
  const show = (value) => {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2);
    return Number(value.toPrecision(4)).toLocaleString("en", { maximumSignificantDigits: 4, useGrouping: false });
  };

  // A slider with a field for the exact value beside it; returns its row and a reader and writer.
  const control = (prefix, { name, label, unit, min, max, step, value }, changed) => {
    const id = `try-${prefix}-${name}`;
    const text = unit ? `${label} (${unit})` : label;
    const slider = make("input", { type: "range", id, min, max, step, value });
    // A field of the type number would drop a decimal comma in silence: 12,5 would be 125.
    const field = make("input", { type: "text", value, "aria-label": `${text}, exact` });
    const read = () => (field.value.trim() ? Number(field.value) : NaN);
    if (min >= 0) field.setAttribute("inputmode", "decimal");
    slider.addEventListener("input", () => {
      field.value = slider.value;
      changed();
    });
    field.addEventListener("input", () => {
      field.setCustomValidity(field.value.includes(",") ? "Write a decimal point." : "");
      field.reportValidity();
      slider.value = read(); // the slider stops at its ends, the field does not
      changed();
    });
    return {
      row: make("div", { class: "try-control" }, make("label", { for: id }, text), slider, field),
      get: read,
      set: (number) => {
        slider.value = number;
        field.value = number;
      },
    };
  };

  // Fill a tool's container with its controls and call `update(values)` at once and on each change.
  // Returns the controls by name and the place for what the tool shows.
  const tool = (name, controls, update) => {
    const container = document.querySelector(`[data-try="${name}"]`);
    const place = make("div", { class: "try-result" });
    const form = make("form", { class: "try-controls", "aria-label": container.dataset.label });
    const byName = {};
    const refresh = () =>
      update(Object.fromEntries(Object.entries(byName).map(([key, one]) => [key, one.get()])));
    for (const one of controls) {
      byName[one.name] = control(name, one, refresh);
      form.append(byName[one.name].row);
    }
    form.addEventListener("submit", (event) => event.preventDefault());
    const button = (text, action) => {
      const one = make("button", { type: "button" }, text);
      one.addEventListener("click", () => {
        action();
        refresh();
      });
      form.append(one);
    };
    button("Back to the first values", () => controls.forEach((one) => byName[one.name].set(one.value)));
    container.replaceChildren(form, place);
    new ResizeObserver(refresh).observe(place);
    return { byName, place, form, button, refresh };
  };

  // Round numbers between two limits, some five of them.
  const ticks = (low, high) => {
    const raw = (high - low) / 5;
    const unit = 10 ** Math.floor(Math.log10(raw));
    const step = unit * [1, 2, 5, 10].find((factor) => factor * unit >= raw);
    const first = Math.ceil(low / step), last = Math.floor(high / step);
    return Array.from({ length: last - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
  };

  // A drawing of lines and dots over two axes, as wide as its place, so that its text stays the page's size.
  // `lines` are {points: [[x, y], …], kind, dots, label}; `says` is its text for who cannot see it.
  const plot = (width, { x, y, xLabel, yLabel, lines, says, height = 260, square = false }) => {
    const left = 58, right = 12, top = 14, bottom = 46;
    const tall = square ? width - left - right + top + bottom : height;
    const toX = (value) => left + ((value - x[0]) / (x[1] - x[0])) * (width - left - right);
    const toY = (value) => tall - bottom - ((value - y[0]) / (y[1] - y[0])) * (tall - top - bottom);
    const clip = (value) => Math.max(-1e4, Math.min(1e4, value));
    const svg = draw("svg", { width, height: tall, viewBox: `0 0 ${width} ${tall}`, role: "img", "aria-label": says });
    const text = (content, attributes) => svg.append(draw("text", attributes, content));
    for (const value of ticks(...x)) {
      svg.append(draw("line", { class: "try-grid", x1: toX(value), x2: toX(value), y1: top, y2: tall - bottom }));
      text(show(value), { x: toX(value), y: tall - bottom + 17, "text-anchor": "middle" });
    }
    for (const value of ticks(...y)) {
      svg.append(draw("line", { class: "try-grid", x1: left, x2: width - right, y1: toY(value), y2: toY(value) }));
      text(show(value), { x: left - 6, y: toY(value) + 5, "text-anchor": "end" });
    }
    text(xLabel, { x: (left + width - right) / 2, y: tall - 8, "text-anchor": "middle" });
    text(yLabel, { transform: `translate(14 ${(top + tall - bottom) / 2}) rotate(-90)`, "text-anchor": "middle" });
    for (const { points, kind, dots } of lines) {
      const places = points.map(([a, b]) => [clip(toX(a)), clip(toY(b))]);
      if (!dots) {
        const path = `M${places.map((one) => one.map((c) => c.toFixed(1)).join(" ")).join("L")}`;
        svg.append(draw("path", { class: `try-line ${kind}`, d: path }));
      } else for (const [cx, cy] of places) svg.append(draw("circle", { class: `try-dot ${kind}`, cx, cy, r: 5 }));
    }
    return svg;
  };

  // Normal deviates, the same for the same seed (mulberry32 and Box–Muller).
  const normals = (count, seed) => {
    let state = seed;
    const uniform = () => {
      state = (state + 0x6d2b79f5) | 0;
      let t = Math.imul(state ^ (state >>> 15), 1 | state);
      t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
      return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
    };
    return Array.from({ length: count }, () =>
      Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform()),
    );
  };

  (globalThis.tryIt ??= {}).ui = { make, draw, show, tool, plot, normals };
}
