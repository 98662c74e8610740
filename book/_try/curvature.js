// Mean and Gaussian curvature of a height map and its surface types, as in microlib.curvature.
// Maps are arrays of rows * cols numbers, row by row; heights and `pitch` in µm.
{
  const binomial = (n) => {
    const row = [1];
    for (let k = 1; k <= n; k++) row.push((row[k - 1] * (n - k + 1)) / k);
    return row.map((value) => value / 2 ** n);
  };

  const convolve = (a, b) => {
    const full = new Array(a.length + b.length - 1).fill(0);
    a.forEach((x, i) => b.forEach((y, j) => (full[i + j] += x * y)));
    return full;
  };

  const sum = (values) => values.reduce((total, value) => total + value, 0);
  const sumOfSquares = (values) => sum(values.map((value) => value * value));

  // Besl's windows (3.15) to (3.19), the smoother folded in: value, slope and second derivative.
  const windows = (size) => {
    const t = Array.from({ length: size }, (_, k) => k - (size - 1) / 2);
    const square = sum(t.map((x) => x * x)) / size;
    const quadratic = t.map((x) => x * x - square);
    const smooth = binomial(size - 1);
    return [
      t.map(() => 1 / size),
      t.map((x) => x / sumOfSquares(t)),
      quadratic.map((q) => (2 * q) / sumOfSquares(quadratic)),
    ].map((window) => convolve(smooth, window));
  };

  // Correlate with the product of two windows; NaN where they leave the map.
  const correlate = (map, rows, cols, alongX, alongY) => {
    const half = (alongX.length - 1) / 2;
    const across = new Float64Array(map.length).fill(NaN);
    const both = new Float64Array(map.length).fill(NaN);
    for (let y = 0; y < rows; y++)
      for (let x = half; x < cols - half; x++) {
        let total = 0;
        for (let k = -half; k <= half; k++) total += alongX[k + half] * map[y * cols + x + k];
        across[y * cols + x] = total;
      }
    for (let y = half; y < rows - half; y++)
      for (let x = 0; x < cols; x++) {
        let total = 0;
        for (let k = -half; k <= half; k++) total += alongY[k + half] * across[(y + k) * cols + x];
        both[y * cols + x] = total;
      }
    return both;
  };

  // H in 1/µm and K in 1/µm² (3.22, 3.23) with their standard errors for heights that are known
  // to `noise` µm; NaN along the border.
  const surfaceCurvature = (height, rows, cols, pitch, size = 7, noise = 0) => {
    const [value, slope, second] = windows(size);
    const field = (alongX, alongY, unit) =>
      correlate(height, rows, cols, alongX, alongY).map((d) => d / unit);
    const zx = field(slope, value, pitch), zy = field(value, slope, pitch);
    const zxx = field(second, value, pitch ** 2), zyy = field(value, second, pitch ** 2);
    const zxy = field(slope, slope, pitch ** 2);
    const scale = (noise / pitch ** 2) ** 2;
    const straight = scale * sumOfSquares(second) * sumOfSquares(value);
    const cross = scale * sum(second.map((s, k) => s * value[k])) ** 2;
    const mixed = scale * sumOfSquares(slope) ** 2;
    const secondOrder = straight ** 2 + cross ** 2 + 2 * mixed ** 2;
    const result = {};
    for (const name of ["mean", "gaussian", "meanUncertainty", "gaussianUncertainty"])
      result[name] = new Float64Array(height.length);
    for (let i = 0; i < height.length; i++) {
      const ex = 1 + zx[i] ** 2, ey = 1 + zy[i] ** 2, steep = 1 + zx[i] ** 2 + zy[i] ** 2;
      const twist = 2 * zx[i] * zy[i];
      result.mean[i] = (ex * zyy[i] - twist * zxy[i] + ey * zxx[i]) / (2 * steep ** 1.5);
      result.gaussian[i] = (zxx[i] * zyy[i] - zxy[i] ** 2) / steep ** 2;
      result.meanUncertainty[i] = Math.sqrt(
        (straight * (ex ** 2 + ey ** 2) + 2 * cross * ex * ey + mixed * twist ** 2) / (4 * steep ** 3),
      );
      const firstOrder =
        straight * (zxx[i] ** 2 + zyy[i] ** 2) + 2 * cross * zxx[i] * zyy[i] + 4 * mixed * zxy[i] ** 2;
      result.gaussianUncertainty[i] = Math.sqrt(Math.max(firstOrder - secondOrder, secondOrder)) / steep ** 2;
    }
    return result;
  };

  // Labels of Table 3.1 by the signs of H and K (3.24, 3.25); 0 where they are not known.
  const hkLabels = (mean, gaussian, hZero, kZero) => {
    const sign = (value, limit) => (value > limit) - (value < -limit);
    return Array.from(mean, (h, i) =>
      Number.isNaN(h) || Number.isNaN(gaussian[i])
        ? 0
        : 1 + 3 * (1 + sign(h, hZero)) + (1 - sign(gaussian[i], kZero)),
    );
  };

  (globalThis.tryIt ??= {}).curvature = { surfaceCurvature, hkLabels };
}
