// The membrane under a point load: the formulas (4.2) to (5.2) of microlib.membrane.
// Lengths in µm and forces in µN, so moduli are in MPa.
{
  // Below this 1 − ζ² the closed forms lose digits and their series is summed, as in the library.
  const SERIES_LIMIT = 0.05, SERIES_TERMS = 16;
  // w_d/a above which small slopes make the modulus 5 % too low or more; SmallSlopeWarning.limit.
  const STEEP = 0.1;
  const LENGTHS = ["force", "rimRadius", "dimpleDepth", "thickness", "probeHalfWidth"];

  const annulus = (zeta) => (1 - zeta) * (1 + zeta);

  // ln ζ² less the first terms of its series in x = 1 − ζ²: −Σ xᵏ/k from `first` on.
  const logRemainder = (zeta, first) => {
    const x = annulus(zeta);
    let sum = x < SERIES_LIMIT ? 0 : 2 * Math.log(zeta);
    if (x >= SERIES_LIMIT) for (let k = 1; k < first; k++) sum += x ** k / k;
    else for (let k = first + SERIES_TERMS - 1; k >= first; k--) sum -= x ** k / k;
    return sum;
  };

  const shapeFactor = (zeta) =>
    (2 * logRemainder(zeta, 3)) / (annulus(zeta) * logRemainder(zeta, 2) ** 3);

  // What the model cannot mean, in words; nothing where it can.
  const refusal = (p) => {
    for (const name of LENGTHS) if (!(p[name] > 0)) return "Every length and the force must be positive.";
    if (!(Math.abs(p.poissonRatio) < 1)) return "The Poisson ratio must lie between −1 and 1.";
    if (!(p.probeHalfWidth < p.rimRadius))
      return "The probe must be narrower than the dimple: c must be below a.";
    if (p.dimpleDepth < p.thickness)
      return "The dimple must be at least as deep as the membrane is thick: a shallower membrane resists mainly by bending.";
    return "";
  };

  // E of (5.2), MPa.
  const elasticModulus = (p) =>
    (p.force * p.rimRadius ** 2 * (1 - p.poissonRatio)) /
    (2 * Math.PI * p.thickness * p.dimpleDepth ** 3 * shapeFactor(p.probeHalfWidth / p.rimRadius));

  // Standard deviation of E to first order, MPa; `stds` by the same names, exact where left out.
  const modulusStd = (p, stds) => {
    const zeta = p.probeHalfWidth / p.rimRadius;
    const x = annulus(zeta);
    const byZeta =
      (2 * x ** 2) / logRemainder(zeta, 3) + (2 * zeta ** 2) / x - (6 * x) / logRemainder(zeta, 2);
    const gradient = {
      force: 1 / p.force,
      rimRadius: (2 + byZeta) / p.rimRadius,
      dimpleDepth: -3 / p.dimpleDepth,
      thickness: -1 / p.thickness,
      probeHalfWidth: -byZeta / p.probeHalfWidth,
      poissonRatio: -1 / (1 - p.poissonRatio),
    };
    const parts = Object.entries(gradient).map(([name, by]) => by * (stds[name] ?? 0));
    return elasticModulus(p) * Math.hypot(...parts);
  };

  // Depth w(r) below the rim, (4.2) with (4.3), µm; flat under the probe and outside the dimple.
  const dimpleProfile = (r, p) => {
    if (r >= p.rimRadius) return 0;
    if (r <= p.probeHalfWidth) return p.dimpleDepth;
    const at = (radius) => logRemainder(radius / p.rimRadius, 2);
    return (p.dimpleDepth * at(r)) / at(p.probeHalfWidth);
  };

  (globalThis.tryIt ??= {}).membrane = { STEEP, refusal, elasticModulus, modulusStd, dimpleProfile };
}
