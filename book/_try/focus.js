// The sum-modified-Laplacian (3.10) to (3.12) and the vertex of a Gaussian through three frames
// (3.13), as in microlib.focus with measure "sml". A frame is {pixels, rows, cols}.
{
  // Beyond its border an image is mirrored about the outermost pixel.
  const mirror = (k, length) => (k < 0 ? -k : k >= length ? 2 * (length - 1) - k : k);

  const modifiedLaplacian = ({ pixels, rows, cols }, x, y) => {
    const at = (u, v) => pixels[mirror(v, rows) * cols + mirror(u, cols)];
    const twice = 2 * at(x, y);
    return Math.abs(twice - at(x - 1, y) - at(x + 1, y)) + Math.abs(twice - at(x, y - 1) - at(x, y + 1));
  };

  const sumModifiedLaplacian = (frame, x, y, window = 5) => {
    const half = (window - 1) / 2;
    let total = 0;
    for (let v = y - half; v <= y + half; v++)
      for (let u = x - half; u <= x + half; u++)
        total += modifiedLaplacian(frame, mirror(u, frame.cols), mirror(v, frame.rows));
    return total;
  };

  // Where a profile over evenly spaced positions has its peak: {index, depth}.
  const gaussianPeak = (profile, positions) => {
    const index = profile.indexOf(Math.max(...profile));
    const here = positions[index];
    if (index === 0 || index === profile.length - 1) return { index, depth: here };
    const before = Math.log(profile[index] / profile[index - 1]);
    const after = Math.log(profile[index] / profile[index + 1]);
    const spacing = positions[1] - positions[0];
    return { index, depth: here + (((before - after) / (before + after)) * spacing) / 2 };
  };

  (globalThis.tryIt ??= {}).focus = { sumModifiedLaplacian, gaussianPeak };
}
