// The error of a feature over time, and its path, for a camera that is turned.
{
  const { make, show, tool, plot } = tryIt.ui;
  const { path } = tryIt.turn;
  const COUNT = 400, LIMIT = 60; // points of a curve; px
  const START = 50; // px

  const verdict = (angle, rate) => {
    const decay = rate * Math.cos((angle * Math.PI) / 180);
    if (decay < 1e-9) return [make("strong", {}, "Not stable. "), "The error does not decay, because the angle is 90° or more."];
    return [
      make("strong", {}, "Stable. "),
      `The error decays at the rate ${show(decay)} per second. It falls to 5 % in ${show(Math.log(20) / decay)} s. ` +
        `Without the rotation, this takes ${show(Math.log(20) / rate)} s.`,
    ];
  };

  const update = ({ angle, rate }) => {
    if (!(Math.abs(angle) <= 180) || !(rate > 0 && rate <= 20)) {
      answer.replaceChildren("The angle must be between −180° and 180°, and the gain must be between 0 and 20 per second.");
      pictures.replaceChildren();
      return;
    }
    answer.replaceChildren(...verdict(angle, rate));
    const end = 5 / rate; // s
    const times = Array.from({ length: COUNT }, (_, k) => (end * k) / (COUNT - 1));
    const turned = path(angle, rate, times), right = path(0, rate, times);
    const size = (points) => points.map((point, k) => [times[k], Math.hypot(...point)]);
    const width = pictures.clientWidth || 340;
    const wide = width > 620;
    const overTime = plot(wide ? width - 316 : width, {
      x: [0, end], y: [0, LIMIT], xLabel: "time (s)", yLabel: "error (px)", height: 300,
      says: `The error over the time, from ${START} px on: with the rotation and without it`,
      lines: [{ points: size(right), kind: "wanted" }, { points: size(turned), kind: "first" }],
    });
    const plane = plot(wide ? 300 : Math.min(width, 320), {
      x: [-LIMIT, LIMIT], y: [-LIMIT, LIMIT], xLabel: "error in x (px)", yLabel: "error in y (px)", square: true,
      says: "The path of the error: with the rotation and without it",
      lines: [{ points: right, kind: "wanted" }, { points: turned, kind: "first" }],
    });
    pictures.replaceChildren(overTime, plane);
  };

  const answer = make("output", { class: "try-answer" });
  const pictures = make("div", { class: "try-pictures" });
  const legend = make("p", { class: "try-legend" },
    make("span", { class: "first" }, "with the rotation"), make("span", { class: "wanted" }, "without the rotation"));
  const { place, refresh } = tool("turn", [
    { name: "angle", label: "Rotation φ that the calibration misses", unit: "degrees", min: -180, max: 180, step: 1, value: 60 },
    { name: "rate", label: "Gain λ", unit: "per second", min: 0.1, max: 10, step: 0.1, value: 2 },
  ], update);
  place.append(answer, legend, pictures);
  refresh();
}
