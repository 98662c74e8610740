// The answer of a delayed visual loop to a step, and its poles.
{
  const { make, show, tool, plot, normals } = tryIt.ui;
  const { poles, respond, noiseGain } = tryIt.loop;
  const STEP = 50, FRAMES = 80, BAND = 0.05; // the step of Table 5.3, px; what counts as settled
  const SEED = 2008;
  const CIRCLE = Array.from({ length: 73 }, (_, k) => [Math.cos((k * Math.PI) / 36), Math.sin((k * Math.PI) / 36)]);

  const settled = (feature) => {
    const last = feature.findLastIndex((f) => Math.abs(f - STEP) > BAND * STEP);
    return last + 1 < feature.length ? last + 1 : NaN;
  };

  const verdict = (gain, delay, jitter, calm) => {
    const slowest = Math.hypot(...poles(gain, delay)[0]);
    const first = `The magnitude of the largest pole is ${show(slowest)}, so `;
    const edge = Math.abs(slowest - 1) < 1e-9; // the poles are exact to about 1e-12
    if (edge) return [make("strong", {}, "At the limit of stability. "), `${first}an error neither grows nor vanishes.`];
    if (slowest > 1) return [make("strong", {}, "Unstable. "), `${first}every error grows.`];
    const frames = settled(calm);
    const overshoot = Math.max(...calm) / STEP - 1;
    return [
      make("strong", {}, "Stable. "),
      `${first}an error finally shrinks by ${show(100 * (1 - slowest))} % per frame. ` +
        (frames ? `The error stays within 5 % after ${frames} ${frames === 1 ? "frame" : "frames"} (${show(frames / 33)} s at 33 Hz). ` : `The error does not stay within 5 % in ${FRAMES} frames. `) +
        `The overshoot is ${show(100 * Math.max(overshoot, 0))} %. ` +
        `The jitter moves the feature with a standard deviation of ${show(jitter * noiseGain(gain, delay))} px.`,
    ];
  };

  const update = ({ gain, delay, jitter }) => {
    const wrong = !(gain > 0) || !(delay >= 0 && delay <= 20) || !(jitter >= 0);
    if (wrong) {
      answer.replaceChildren("The gain must be positive, the delay must be between 0 and 20 frames, and the jitter must not be negative.");
      pictures.replaceChildren();
      return;
    }
    const calm = respond(gain, delay, STEP, new Array(FRAMES).fill(0));
    const shaken = respond(gain, delay, STEP, normals(FRAMES, SEED).map((n) => jitter * n));
    answer.replaceChildren(...verdict(gain, delay, jitter, calm));
    const overTime = (feature) => feature.map((f, k) => [k, f]);
    const width = pictures.clientWidth || 340;
    const wide = width > 620;
    const answered = plot(wide ? width - 316 : width, {
      x: [0, FRAMES], y: [-STEP / 2, 2 * STEP], xLabel: "frame", yLabel: "feature (px)", height: 300,
      says: "The feature over the frames after a step of 50 px: without jitter, and with one draw of it",
      lines: [
        { points: [[0, STEP], [FRAMES, STEP]], kind: "wanted" },
        { points: overTime(shaken), kind: "second" },
        { points: overTime(calm), kind: "first" },
      ],
    });
    const found = poles(gain, delay);
    const reach = Math.max(1.2, 1.1 * Math.hypot(...found[0]));
    const circle = plot(wide ? 300 : Math.min(width, 320), {
      x: [-reach, reach], y: [-reach, reach], xLabel: "real part", yLabel: "imaginary part", square: true,
      says: `Poles and the unit circle; the largest modulus is ${show(Math.hypot(...found[0]))}`,
      lines: [{ points: CIRCLE, kind: "wanted" }, { points: found, kind: "first", dots: true }],
    });
    pictures.replaceChildren(answered, circle);
  };

  const answer = make("output", { class: "try-answer" });
  const pictures = make("div", { class: "try-pictures" });
  const legend = make("p", { class: "try-legend" },
    make("span", { class: "first" }, "without jitter"), make("span", { class: "second" }, "with jitter"),
    make("span", { class: "wanted" }, "target; unit circle"));
  const { place, refresh } = tool("loop", [
    { name: "gain", label: "Gain g", unit: "fraction of the error per frame", min: 0.02, max: 2.2, step: 0.01, value: 0.5 },
    { name: "delay", label: "Delay", unit: "frames", min: 0, max: 5, step: 0.05, value: 1 },
    { name: "jitter", label: "Jitter of the measurement", unit: "px", min: 0, max: 5, step: 0.05, value: 1 },
  ], update);
  place.append(answer, legend, pictures);
  refresh();
}
