// An integrator under delayed proportional control: the poles of microlib.servoing.loop_poles and
// the answer of the same loop, frame by frame.
{
  const split = (delay) => [Math.floor(delay), delay - Math.floor(delay)];

  // z^(n+1) (z − 1) + g ((1 − θ) z + θ) for a delay of n + θ frames, highest power first.
  const polynomial = (gain, delay) => {
    const [whole, part] = split(delay);
    const p = new Array(whole + 3).fill(0);
    p[0] = 1;
    p[1] = -1;
    p[whole + 1] += gain * (1 - part);
    p[whole + 2] += gain * part;
    return p;
  };

  const times = ([a, b], [c, d]) => [a * c - b * d, a * d + b * c];
  const over = ([a, b], [c, d]) => {
    const size = c * c + d * d;
    return [(a * c + b * d) / size, (b * c - a * d) / size];
  };

  // Roots of a real polynomial as [re, im], by the method of Aberth and Ehrlich: Newton's steps,
  // each root pushed off by the others.
  const roots = (coefficients) => {
    const p = coefficients.slice();
    const zeros = [];
    while (p.at(-1) === 0) zeros.push([p.pop(), 0]);
    const degree = p.length - 1;
    const z = Array.from({ length: degree }, (_, k) => {
      const angle = (2 * Math.PI * k) / degree + 0.4; // off the real axis, where roots pair up
      return [Math.cos(angle), Math.sin(angle)];
    });
    for (let round = 0; round < 200; round++) {
      let moved = 0;
      for (let k = 0; k < degree; k++) {
        let value = [p[0], 0], slope = [0, 0];
        for (const c of p.slice(1)) {
          slope = times(slope, z[k]).map((part, i) => part + value[i]);
          value = times(value, z[k]);
          value[0] += c;
        }
        if (value[0] === 0 && value[1] === 0) continue;
        let push = over(slope, value);
        for (let j = 0; j < degree; j++)
          if (j !== k) {
            const away = over([1, 0], [z[k][0] - z[j][0], z[k][1] - z[j][1]]);
            push = [push[0] - away[0], push[1] - away[1]];
          }
        const step = over([1, 0], push);
        z[k] = [z[k][0] - step[0], z[k][1] - step[1]];
        moved = Math.max(moved, Math.hypot(...step) / Math.hypot(...z[k]));
      }
      if (moved < 1e-15) break;
    }
    return [...z, ...zeros];
  };

  // Closed-loop poles, largest modulus first; the loop is stable if that is below 1.
  const poles = (gain, delay) =>
    roots(polynomial(gain, delay)).sort((a, b) => Math.hypot(...b) - Math.hypot(...a));

  // The feature in px, frame by frame, from 0 towards `target`; `noise` is what each measurement
  // is wrong by, px. A command takes effect `delay` frames after the exposure it came from.
  const respond = (gain, delay, target, noise) => {
    const [whole, part] = split(delay);
    const commands = new Array(whole + 1).fill(0);
    const feature = [0];
    for (let k = 0; k + 1 < noise.length; k++) {
      commands.push(gain * (target - feature[k] - noise[k]));
      feature.push(feature[k] + (1 - part) * commands[k + 1] + part * commands[k]);
    }
    return feature;
  };

  // Share of the measurements' noise that the settled feature shakes by: the root of the sum of
  // squares of its answer to one wrong measurement.
  const noiseGain = (gain, delay) => {
    const slowest = Math.hypot(...poles(gain, delay)[0]);
    if (slowest >= 1) return Infinity;
    // Long enough for what is left to be below rounding, 1e-16; at most some 40 000 frames.
    const count = Math.min(Math.ceil(-37 / Math.log(Math.max(slowest, 1e-16))) + 50, 40000);
    const impulse = new Array(count).fill(0);
    impulse[0] = 1;
    return Math.sqrt(respond(gain, delay, 0, impulse).reduce((sum, f) => sum + f * f, 0));
  };

  (globalThis.tryIt ??= {}).loop = { poles, respond, noiseGain };
}
