// The error of a feature under the control law (2.3) if the calibration misses a rotation of the
// camera by the angle φ about the optical axis: ė = −λ R(−φ) e, in px, from (50, 0) on.
{
  const START = 50;

  const path = (degrees, rate, times) => {
    const angle = (degrees * Math.PI) / 180;
    return times.map((t) => {
      const size = START * Math.exp(-rate * Math.cos(angle) * t);
      const turned = rate * Math.sin(angle) * t;
      return [size * Math.cos(turned), size * Math.sin(turned)];
    });
  };

  (globalThis.tryIt ??= {}).turn = { path };
}
