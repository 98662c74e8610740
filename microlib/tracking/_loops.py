"""Compiled loops of the robust search: sampling, local statistics, weighted normal equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from microlib._common import Array, Image

#: Standard deviation of a normal variable over the median of its size.
_NORMAL = 1.4826

#: Least share of the template that an alignment must see, and the largest change of its area.
_LEAST_SHOWN, _AREA_FACTOR = 0.15, 4.0

#: Correlation of the surroundings, and trust, of the pixels whose residuals tell their size.
_ALIKE, _TRUSTED = 0.5, 0.3

#: Sum of the sizes of a matrix of motion above which it is none.
_HUGE = 1e3

#: Relative and absolute ridge of the light: knots that no pixel shows stay as they are.
_RIDGE, _LEAST_RIDGE = 1e-6, 1e-3

#: Rounds of reweighting before the first step in smooth light.
_ROUNDS = 5

#: Where Tukey's biweight ends, in standard deviations: 95 % efficient for normal noise.
TUKEY = 4.685


#: Divisions by zero give what NumPy's do and are told from the result; no lock of the interpreter.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile, and keep the machine code where a folder allows."""
    try:
        return numba.njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # no folder to write to
        return numba.njit(**_OPTIONS)(function)


@_compiled
def sample_patch(image: Image, warp: Array, patch: Image, inside: Image) -> None:
    """Sample `image` linearly at ``warp (column, row, 1)``; `inside` tells what it shows."""
    height, width = image.shape
    rows, columns = patch.shape
    for row in range(rows):
        for column in range(columns):
            depth = warp[2, 0] * column + warp[2, 1] * row + warp[2, 2]
            scale = 1.0 / depth if depth > 1e-6 else 0.0
            x = (warp[0, 0] * column + warp[0, 1] * row + warp[0, 2]) * scale
            y = (warp[1, 0] * column + warp[1, 1] * row + warp[1, 2]) * scale
            shown = scale > 0.0 and 0.0 <= x <= width - 1 and 0.0 <= y <= height - 1
            inside[row, column] = 1.0 if shown else 0.0
            x = min(x, width - 1.0) if x > 0.0 else 0.0  # also where it is not a number
            y = min(y, height - 1.0) if y > 0.0 else 0.0
            left = min(int(x), width - 2)
            top = min(int(y), height - 2)
            u = np.float32(x - left)
            v = np.float32(y - top)
            upper = image[top, left] + u * (image[top, left + 1] - image[top, left])
            lower = image[top + 1, left] + u * (image[top + 1, left + 1] - image[top + 1, left])
            patch[row, column] = upper + v * (lower - upper)


@_compiled
def smooth(source: Image, kernel: Image, target: Image) -> None:
    """Convolve with a symmetric separable kernel; beyond the border there is nothing (zeros)."""
    rows, columns = source.shape
    radius = len(kernel) // 2
    padded = np.zeros((rows + 2 * radius, columns), np.float32)
    line = np.zeros(columns + 2 * radius, np.float32)
    for row in range(rows):
        across = padded[row + radius]
        for column in range(columns):
            line[radius + column] = source[row, column]
        for column in range(columns):
            across[column] = kernel[radius] * line[radius + column]
        for k in range(1, radius + 1):
            factor, before, after = kernel[radius + k], line[radius - k :], line[radius + k :]
            for column in range(columns):
                across[column] += factor * (before[column] + after[column])
    for row in range(rows):
        down, middle = target[row], padded[row + radius]
        for column in range(columns):
            down[column] = kernel[radius] * middle[column]
        for k in range(1, radius + 1):
            factor, above, below = (
                kernel[radius + k],
                padded[row + radius - k],
                padded[row + radius + k],
            )
            for column in range(columns):
                down[column] += factor * (above[column] + below[column])


@_compiled
def patch_at(
    image: Image,
    warp: Array,
    kernel: Image,
    pad: int,
    grey: Image,
    slope: Image,
    inside: Image,
) -> None:
    """Fill grey values, gradient (x and y) and visibility of the patch that a warp cuts out.

    No gradient is made where `slope` is empty.

    The patch is sampled with `pad` pixels more on each side, smoothed, and differentiated with
    fourth-order central differences.
    """
    rows, columns = grey.shape
    shape = (rows + 2 * pad, columns + 2 * pad)
    padded, shown = np.empty(shape, np.float32), np.empty(shape, np.float32)
    sample_patch(image, warp, padded, shown)
    if len(kernel) > 1:
        smoothed = np.empty(shape, np.float32)
        smooth(padded, kernel, smoothed)
        padded = smoothed
    for row in range(rows):
        for column in range(columns):
            grey[row, column] = padded[row + pad, column + pad]
            inside[row, column] = shown[row + pad, column + pad]
    near, far = np.float32(2 / 3), np.float32(1 / 12)
    for row in range(rows if slope.size else 0):
        y = row + pad
        for column in range(columns):
            x = column + pad
            slope[0, row * columns + column] = near * (
                padded[y, x + 1] - padded[y, x - 1]
            ) - far * (padded[y, x + 2] - padded[y, x - 2])
            slope[1, row * columns + column] = near * (
                padded[y + 1, x] - padded[y - 1, x]
            ) - far * (padded[y + 2, x] - padded[y - 2, x])


@_compiled
def local_fit(
    grey: Image,
    template: Image,
    share: Image,
    changed: bool,
    wide: Image,
    floor: float,
    sums: Image,
    residual: Image,
    gain: Image,
    correlation: Image,
) -> None:
    """Fit ``grey ≈ gain·template + bias`` around each pixel; fill residual, gain, correlation.

    The surroundings are weighted by the Gaussian `wide` and by `share`; `floor` is the variance of
    the noise, which keeps what is flat from correlating by chance. `sums` (6×H×W) keeps the local
    sums, of which those of the template alone are made anew only if `share` has `changed`.
    """
    rows, columns = grey.shape
    weighted = np.empty((rows, columns), np.float32)
    product = np.empty((rows, columns), np.float32)
    if changed:
        smooth(share, wide, sums[0])
        for row in range(rows):
            for column in range(columns):
                weighted[row, column] = share[row, column] * template[row, column]
                product[row, column] = weighted[row, column] * template[row, column]
        smooth(weighted, wide, sums[1])
        smooth(product, wide, sums[2])
    for row in range(rows):
        for column in range(columns):
            weighted[row, column] = share[row, column] * grey[row, column]
            product[row, column] = weighted[row, column] * grey[row, column]
    smooth(weighted, wide, sums[3])
    smooth(product, wide, sums[4])
    for row in range(rows):
        for column in range(columns):
            product[row, column] = weighted[row, column] * template[row, column]
    smooth(product, wide, sums[5])
    low, high = np.float32(0.1), np.float32(10.0)
    least, noise = np.float32(1e-6), np.float32(floor)
    for row in range(rows):
        for column in range(columns):
            scale = np.float32(1.0) / max(sums[0, row, column], least)
            t, g = sums[1, row, column] * scale, sums[3, row, column] * scale
            tt = max(sums[2, row, column] * scale - t * t, np.float32(0.0)) + noise
            gg = max(sums[4, row, column] * scale - g * g, np.float32(0.0)) + noise
            tg = sums[5, row, column] * scale - t * g
            factor = min(max(tg / tt, low), high)
            gain[row, column] = factor
            residual[row, column] = grey[row, column] - g - factor * (template[row, column] - t)
            correlation[row, column] = tg / np.sqrt(tt * gg)


@_compiled
def _times(left: Array, right: Array) -> Array:
    """Return the product of two 3×3 matrices; the general product takes longer to compile."""
    product = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                product[i, j] += left[i, k] * right[k, j]
    return product


@_compiled
def moved(warp: Array, step: Array, basis: Array) -> Array:
    """Return ``warp exp(Σ stepₖ basisₖ)``; a step that is not finite or huge gives zeros."""
    matrix, size = np.zeros((3, 3)), 0.0
    for k in range(len(basis)):
        for i in range(3):
            for j in range(3):
                matrix[i, j] += step[k] * basis[k, i, j]
    for i in range(3):
        for j in range(3):
            size += abs(matrix[i, j])
    if not size < _HUGE:
        return np.zeros((3, 3))
    halvings = 0
    while size > 0.5:
        size /= 2
        halvings += 1
    total, term = np.eye(3), np.eye(3)
    for i in range(3):
        for j in range(3):
            matrix[i, j] /= 2.0**halvings
    for order in range(1, 16):  # 0.5¹⁶/16! is 10⁻¹⁸
        term = _times(term, matrix)
        for i in range(3):
            for j in range(3):
                term[i, j] /= order
                total[i, j] += term[i, j]
    for _ in range(halvings):
        total = _times(total, total)
    return _times(warp, total)


@_compiled
def _solve(matrix: Array, right: Array) -> bool:
    """Solve a positive definite system in place (Cholesky); tell whether it was one."""
    n = len(right)
    for j in range(n):
        for k in range(j):
            factor = matrix[j, k]
            for i in range(j, n):
                matrix[i, j] -= factor * matrix[i, k]
        if not matrix[j, j] > 0:
            return False
        pivot = np.sqrt(matrix[j, j])
        for i in range(j, n):
            matrix[i, j] /= pivot
    for i in range(n):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True


@_compiled
def _median(values: Image, count: int) -> float:
    """Return the upper median of the first values by Hoare's selection; it reorders them."""
    low, high, middle = 0, count - 1, count // 2
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                swapped = values[i]
                values[i] = values[j]
                values[j] = swapped
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return values[middle]


@_compiled
def weighted_normal(
    flow: Image, slope: Image, residual: Image, weight: Image, normal: Array, right: Array
) -> None:
    """Fill ``JᵀWJ`` and ``JᵀWr`` for the Jacobian ``J = flow · slope``, all arrays N long."""
    n = flow.shape[1]
    size = flow.shape[2]
    rows = np.empty((n, size), np.float32)
    for k in range(n):
        for i in range(size):
            rows[k, i] = flow[0, k, i] * slope[0, i] + flow[1, k, i] * slope[1, i]
    weighted = np.empty(size, np.float32)
    for k in range(n):
        for i in range(size):
            weighted[i] = rows[k, i] * weight[i]
        total = np.float32(0.0)
        for i in range(size):
            total += weighted[i] * residual[i]
        right[k] = total
        for m in range(k, n):
            total = np.float32(0.0)
            for i in range(size):
                total += weighted[i] * rows[m, i]
            normal[k, m] = total
            normal[m, k] = total


@_compiled
def corners_of(warp: Array, corners: Array) -> Array:
    """Map N×2 points by a homography."""
    mapped = np.empty_like(corners)
    for i in range(len(corners)):
        depth = warp[2, 0] * corners[i, 0] + warp[2, 1] * corners[i, 1] + warp[2, 2]
        for k in range(2):
            mapped[i, k] = (
                warp[k, 0] * corners[i, 0] + warp[k, 1] * corners[i, 1] + warp[k, 2]
            ) / depth
    return mapped


@_compiled
def align_locally(
    image: Image,
    warp: Array,
    basis: Array,
    flow: Image,
    template: Image,
    template_slope: Image,
    mask: Image,
    kernel: Image,
    pad: int,
    wide: Image,
    noise: float,
    ceiling: float,
    prior: Array,
    corners: Array,
    iterations: int,
    tolerance: float,
) -> tuple[Array, int]:
    """Align in local illumination with robust weights.

    `warp` maps px of the padded patch to samples of the image, `basis` are generators in those
    px. Returns the warp and the steps, 0 where it gave up.
    """
    rows, columns = shape = template.shape
    n, size = len(basis), template.size
    grey, inside = np.empty(shape, np.float32), np.empty(shape, np.float32)
    share, residual = np.zeros(shape, np.float32), np.empty(shape, np.float32)
    gain, sums = np.empty(shape, np.float32), np.empty((6, rows, columns), np.float32)
    weight, correlation = np.empty(shape, np.float32), np.empty(shape, np.float32)
    slope, kept = np.empty((2, size), np.float32), np.empty(size, np.float32)
    normal, right, total = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    first = before = corners_of(warp, corners)
    start, scale = warp, noise
    for count in range(1, iterations + 1):
        patch_at(image, warp, kernel, pad, grey, slope, inside)
        shown, changed = _see(grey, template, mask, inside, ceiling, share)
        if shown < _LEAST_SHOWN * size:
            return start, 0
        changed = changed or count == 1
        local_fit(grey, template, share, changed, wide, noise**2, sums, residual, gain, correlation)
        m = _collect(residual, correlation, _ALIKE, share, kept)
        scale = max(_NORMAL * _median(kept, m), noise) if m > size // 20 else max(scale, 2 * noise)
        _weigh(residual, correlation, share, gain, TUKEY * scale, template_slope, weight, slope)
        weighted_normal(flow, slope, residual.ravel(), weight.ravel(), normal, right)
        for k in range(n):
            right[k] = -right[k] / scale**2
            for j in range(n):
                normal[k, j] = normal[k, j] / scale**2 + prior[k, j]
                right[k] -= prior[k, j] * total[j]
            normal[k, k] *= 1 + 1e-9
        if not _solve(normal, right):
            return start, 0
        for k in range(n):
            total[k] += right[k]
        warp = moved(warp, right, basis)
        after = corners_of(warp, corners)
        if _torn(warp, after, first):
            return start, 0
        way = _largest_move(before, after)
        before = after
        if way < tolerance:
            break
    return warp, count


@_compiled
def _see(
    grey: Image, template: Image, mask: Image, inside: Image, ceiling: float, share: Image
) -> tuple[float, bool]:
    """Fill how far each pixel counts; return the sum, and whether any has changed.

    What is saturated in the image but not in the template shows nothing.
    """
    rows, columns = grey.shape
    shown, changed = 0.0, False
    for row in range(rows):
        for column in range(columns):
            seen = mask[row, column] * inside[row, column]
            if grey[row, column] >= ceiling and template[row, column] < ceiling:
                seen = np.float32(0.0)
            changed = changed or seen != share[row, column]
            share[row, column] = seen
            shown += seen
    return shown, changed


@_compiled
def _collect(residual: Image, score: Image, least: float, share: Image, kept: Image) -> int:
    """Gather the sizes of the residuals whose pixels count and have this score; tell how many."""
    m = 0
    rows, columns = residual.shape
    for row in range(rows):
        for column in range(columns):
            if share[row, column] > 0 and score[row, column] > least:
                kept[m] = abs(residual[row, column])
                m += 1
    return m


@_compiled
def _weigh(
    residual: Image,
    correlation: Image,
    share: Image,
    gain: Image,
    limit: float,
    template_slope: Image,
    weight: Image,
    slope: Image,
) -> None:
    """Fill the weights, and the mean of the image's and the template's gradient."""
    rows, columns = residual.shape
    inverse, half = np.float32(1.0 / limit), np.float32(0.5)
    for row in range(rows):
        for column in range(columns):
            u = residual[row, column] * inverse
            w = max(1 - u * u, np.float32(0.0))
            positive = max(correlation[row, column], np.float32(0.0))
            weight[row, column] = share[row, column] * positive * w * w
            i = row * columns + column
            for k in range(2):
                slope[k, i] = half * (slope[k, i] + gain[row, column] * template_slope[k, i])


@_compiled
def _torn(warp: Array, corners: Array, first: Array) -> bool:
    """Return whether a warp is none, turned the template over or changed its area too much."""
    ratio = _quadrilateral(corners) / _quadrilateral(first)
    return warp[2, 2] == 0 or not 1 / _AREA_FACTOR < ratio < _AREA_FACTOR  # also True for NaN


@_compiled
def _largest_move(before: Array, after: Array) -> float:
    largest = 0.0
    for i in range(len(before)):
        for k in range(2):
            largest = max(largest, abs(after[i, k] - before[i, k]))
    return largest


@_compiled
def _quadrilateral(corners: Array) -> float:
    ax, ay = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
    bx, by = corners[3, 0] - corners[1, 0], corners[3, 1] - corners[1, 1]
    return 0.5 * (ax * by - ay * bx)


@_compiled
def block_sums(
    grey: Image, template: Image, share: Image, across: Array, down: Array, sums: Array
) -> None:
    """Fill the sums of share, T, I, T², I², TI over blocks of 2×2 cells with these edges."""
    rows, columns = len(down) - 1, len(across) - 1
    cells = np.zeros((rows, columns, 6))
    for j in range(rows):
        for i in range(columns):
            count = np.float32(0.0)
            st, sg, tt, gg, tg = count, count, count, count, count
            for row in range(down[j], down[j + 1]):
                for column in range(across[i], across[i + 1]):
                    w, t, g = share[row, column], template[row, column], grey[row, column]
                    count += w
                    st += w * t
                    sg += w * g
                    tt += w * t * t
                    gg += w * g * g
                    tg += w * t * g
            cells[j, i, 0], cells[j, i, 1], cells[j, i, 2] = count, st, sg
            cells[j, i, 3], cells[j, i, 4], cells[j, i, 5] = tt, gg, tg
    for j in range(rows - 1):
        for i in range(columns - 1):
            for k in range(6):
                sums[j, i, k] = (
                    cells[j, i, k]
                    + cells[j + 1, i, k]
                    + cells[j, i + 1, k]
                    + cells[j + 1, i + 1, k]
                )


@_compiled
def _weighted_median(values: Array, weights: Array) -> float:
    half, best = 0.0, np.inf
    for w in weights:
        half += w / 2
    for value in values:
        below = 0.0
        for k in range(len(values)):
            if values[k] <= value:
                below += weights[k]
        if below >= half and value < best:
            best = value
    return best


@_compiled
def judge_blocks(
    sums: Array,
    expected: float,
    chance: float,
    odd: float,
    agreeing: float,
    relative: float,
    largest: float,
) -> tuple[float, float, float, float, float]:
    """Return score, share, agreeing, texture and drift of `Agreement` from the blocks' sums."""
    blocks = len(sums)
    full = 1e-9
    for b in range(blocks):
        full = max(full, sums[b, 0])
    gain, weight = np.zeros(blocks), np.zeros(blocks)
    information, variance = np.zeros(blocks), np.zeros(blocks)
    residual, seen = np.zeros(blocks), np.zeros(blocks)
    total = np.zeros(6)
    for b in range(blocks):
        seen[b] = sums[b, 0] / full
        count = max(sums[b, 0], 1e-9)
        t, g = sums[b, 1] / count, sums[b, 2] / count
        tv = max(sums[b, 3] / count - t * t, 1e-9)
        gv = max(sums[b, 4] / count - g * g, 1e-9)
        both = sums[b, 5] / count - t * g
        square = min(both * both / (tv * gv), 0.9999) if both > 0 else 0.0
        variance[b], residual[b] = gv, gv * (1 - square)
        information[b] = -0.5 * np.log(1 - square)
        gain[b] = np.log(min(max(both / tv, 1e-2), 1e2))
        weight[b] = information[b] * seen[b] if information[b] > chance else 0.0
        for k in range(6):
            total[k] += sums[b, k]
    middle = _weighted_median(gain, weight)
    count, t, g = max(total[0], 1e-9), total[1], total[2]
    spread = total[3] - t * t / count
    slope = (total[5] - t * g / count) / spread if spread > 0 else 0.0
    bias = (g - slope * t) / count
    score, share, texture, fine, drift = 0.0, 0.0, 0.0, 0.0, 0.0
    for b in range(blocks):
        says = information[b] - chance - (gain[b] - middle) ** 2
        if says > 0:
            score += says * seen[b] / (1 + residual[b] / expected / odd)
            share += 1.0 / blocks
        say = min(max(variance[b] / expected - 1, 0.0), largest) * seen[b]
        texture += say
        if residual[b] <= agreeing * expected + relative * variance[b]:
            fine += say
        if sums[b, 0] > 0:
            drift += say * ((sums[b, 2] - slope * sums[b, 1]) / sums[b, 0] - bias) ** 2
    return (
        score,
        share,
        fine / texture if texture > 0 else 0.0,
        texture,
        np.sqrt(drift / texture) if texture > 0 else 0.0,
    )


@_compiled
def block_votes(
    window: Image,
    template: Image,
    across: Array,
    down: Array,
    least: float,
    floor: float,
    votes: Image,
) -> None:
    """Fill the information, in nats beyond `least`, of each block at each shift of the window.

    `votes` has the shape (blocks down, blocks across, shifts down, shifts across); the shift
    (0, 0) lays the template's first pixel onto the window's.
    """
    rows, columns = len(down) - 1, len(across) - 1
    high, wide = votes.shape[2], votes.shape[3]
    first, second = _integrals(window)
    cross = np.empty((rows, columns, wide), np.float32)
    total, energy = np.zeros((rows, columns)), np.zeros((rows, columns))
    for j in range(rows):
        for i in range(columns):
            for row in range(down[j], down[j + 1]):
                for column in range(across[i], across[i + 1]):
                    total[j, i] += template[row, column]
                    energy[j, i] += template[row, column] ** 2
    bound, square = 1.0 - np.exp(-2.0 * least), np.empty(wide)
    for dy in range(high):
        _cross_sums(window, template, across, down, dy, cross)
        for j in range(rows - 1):
            for i in range(columns - 1):
                count = (down[j + 2] - down[j]) * (across[i + 2] - across[i])
                st = total[j, i] + total[j + 1, i] + total[j, i + 1] + total[j + 1, i + 1]
                tt = energy[j, i] + energy[j + 1, i] + energy[j, i + 1] + energy[j + 1, i + 1]
                tt -= st * st / count
                y0, y1 = down[j] + dy, down[j + 2] + dy
                x0, x1 = across[i], across[i + 2]
                for dx in range(wide):  # without branches, so that it is done by vectors
                    sg = first[y1, x1 + dx] - first[y0, x1 + dx]
                    sg -= first[y1, x0 + dx] - first[y0, x0 + dx]
                    gg = second[y1, x1 + dx] - second[y0, x1 + dx]
                    gg -= second[y1, x0 + dx] - second[y0, x0 + dx] + sg * sg / count
                    tg = cross[j, i, dx] + cross[j + 1, i, dx]
                    tg += cross[j, i + 1, dx] + cross[j + 1, i + 1, dx] - st * sg / count
                    square[dx] = tg * abs(tg) / ((tt + count * floor) * (gg + count * floor))
                for dx in range(wide):
                    vote = np.float32(0.0)
                    if square[dx] > bound:
                        vote = -0.5 * np.log(1.0 - min(square[dx], 0.9999)) - least
                    votes[j, i, dy, dx] = vote


@_compiled
def _integrals(window: Image) -> tuple[Array, Array]:
    """Return the sums of an image and of its square over all above and left of each pixel."""
    height, width = window.shape
    first = np.zeros((height + 1, width + 1))
    second = np.zeros((height + 1, width + 1))
    for y in range(height):
        line, square = 0.0, 0.0
        for x in range(width):
            line += window[y, x]
            square += window[y, x] * window[y, x]
            first[y + 1, x + 1] = first[y, x + 1] + line
            second[y + 1, x + 1] = second[y, x + 1] + square
    return first, second


@_compiled
def _cross_sums(
    window: Image, template: Image, across: Array, down: Array, dy: int, cross: Image
) -> None:
    """Fill the sums of template times window over each cell, at each shift along the rows."""
    rows, columns, wide = cross.shape
    for j in range(rows):
        for i in range(columns):
            line = cross[j, i]
            for dx in range(wide):
                line[dx] = 0
            for row in range(down[j], down[j + 1]):
                for column in range(across[i], across[i + 1]):
                    t = template[row, column]
                    for dx in range(wide):
                        line[dx] += t * window[row + dy, column + dx]


@_compiled
def align_lit(
    image: Image,
    warp: Array,
    basis: Array,
    flow: Image,
    template: Image,
    light: Image,
    template_slope: Image,
    tone: Image,
    trust: Image,
    kernel: Image,
    pad: int,
    noise: float,
    ceiling: float,
    corners: Array,
    iterations: int,
    tolerance: float,
    weight: Image,
    residual: Image,
    design: Image,
    normal: Array,
    solution: Array,
) -> tuple[Array, int, float]:
    """Align with the light as a sum of `light` (L×N) and Tukey's weights, times `trust`.

    The gain of the template's gradient at each pixel is the sum of `tone`, the derivatives of the
    first lights by the template's grey value, by the same coefficients. Fills weight, residual,
    design and normal matrix of the last step, and the coefficients `solution`. Returns the warp,
    the steps (0 where it gave up) and the standard deviation of the residual.
    """
    n, m, size = len(basis), len(light), trust.size
    shape = trust.shape
    grey, inside = np.empty(shape, np.float32), np.empty(shape, np.float32)
    share = np.zeros(shape, np.float32)
    slope, gain = np.empty((2, size), np.float32), np.empty(size, np.float32)
    weighted, kept = np.empty(size, np.float32), np.empty(size, np.float32)
    right, amounts = np.zeros(n + m), np.zeros(m)
    system = np.zeros((n + m, n + m))
    first = before = corners_of(warp, corners)
    start, scale, steps = warp, 0.0, 0
    for k in range(m):
        for i in range(size):
            design[n + k, i] = light[k, i]
    for _ in range(iterations):
        steps += 1
        patch_at(image, warp, kernel, pad, grey, slope, inside)
        _see(grey, template, trust, inside, ceiling, share)
        counted = share.ravel()
        if steps == 1 and not _first_light(
            grey.ravel(), light, counted, noise, weight, weighted, kept, residual, amounts
        ):
            return start, 0, scale
        _less_light(grey.ravel(), light, amounts, residual)
        _lit_slope(amounts, tone, template_slope, gain, slope)
        for k in range(n):
            for i in range(size):
                design[k, i] = flow[0, k, i] * slope[0, i] + flow[1, k, i] * slope[1, i]
        count = _some(residual, counted, kept)
        if 2 * count < 3 * (n + m):
            return start, 0, scale
        scale = max(_NORMAL * _median(kept, count), noise)
        _reweigh(residual, counted, TUKEY * scale, weight)
        _fill(design, residual, weight, weighted, normal, right)
        for k in range(n + m):
            for i in range(n + m):
                system[k, i] = normal[k, i]
            system[k, k] *= 1 + _RIDGE
            if k >= n:
                system[k, k] += _LEAST_RIDGE
        if not _solve(system, right):
            return start, 0, scale
        for k in range(m):
            amounts[k] += right[n + k]
            solution[k] = amounts[k]
        for k in range(n):
            right[k] = -right[k]
        warp = moved(warp, right, basis)
        after = corners_of(warp, corners)
        if _torn(warp, after, first):
            return start, 0, scale
        way = _largest_move(before, after)
        before = after
        if way < tolerance:
            break
    return warp, steps, scale


@_compiled
def _first_light(
    level: Image,
    light: Image,
    share: Image,
    noise: float,
    weight: Image,
    weighted: Image,
    kept: Image,
    residual: Image,
    amounts: Array,
) -> bool:
    """Fit the light alone, robustly, at the pose as it is; tell whether there is enough to fit."""
    m = len(light)
    normal = np.zeros((m, m))
    for i in range(len(level)):
        weight[i] = share[i]
    for turn in range(_ROUNDS):
        if turn > 0:
            _less_light(level, light, amounts, residual)
            count = _some(residual, share, kept)
            if 2 * count < 3 * m:
                return False
            _reweigh(residual, share, TUKEY * max(_NORMAL * _median(kept, count), noise), weight)
        _fill(light, level, weight, weighted, normal, amounts)
        for k in range(m):
            normal[k, k] = normal[k, k] * (1 + _RIDGE) + _LEAST_RIDGE
        if not _solve(normal, amounts):
            return False
    return True


@_compiled
def _some(residual: Image, share: Image, kept: Image) -> int:
    """Gather the sizes of every other residual that is trusted; tell how many."""
    count = 0
    for i in range(0, len(residual), 2):
        if share[i] > _TRUSTED:
            kept[count] = abs(residual[i])
            count += 1
    return count


@_compiled
def _lit_slope(
    amounts: Array, tone: Image, template_slope: Image, gain: Image, slope: Image
) -> None:
    """Turn the image's gradient into its mean with that of the template in its light."""
    half = np.float32(0.5)
    for i in range(len(gain)):
        gain[i] = 0
    for k in range(len(tone)):
        amount = np.float32(amounts[k])
        for i in range(len(gain)):
            gain[i] += amount * tone[k, i]
    for k in range(2):
        for i in range(len(gain)):
            slope[k, i] = half * (slope[k, i] + gain[i] * template_slope[k, i])


@_compiled
def _less_light(level: Image, light: Image, amounts: Array, residual: Image) -> None:
    for i in range(len(level)):
        residual[i] = level[i]
    for k in range(len(light)):
        amount = np.float32(amounts[k])
        for i in range(len(level)):
            residual[i] -= amount * light[k, i]


@_compiled
def _reweigh(residual: Image, share: Image, limit: float, weight: Image) -> None:
    inverse = np.float32(1.0 / limit)
    for i in range(len(residual)):
        u = residual[i] * inverse
        w = 1 - u * u
        weight[i] = share[i] * w * w if w > 0 else np.float32(0.0)


@_compiled
def _fill(
    design: Image, value: Image, weight: Image, weighted: Image, normal: Array, right: Array
) -> None:
    """Fill ``XWXᵀ`` and ``XWy``."""
    n, size = design.shape
    for k in range(n):
        total = np.float32(0.0)
        for i in range(size):
            weighted[i] = design[k, i] * weight[i]
        for i in range(size):
            total += weighted[i] * value[i]
        right[k] = total
        for m in range(k, n):
            total = np.float32(0.0)
            for i in range(size):
                total += weighted[i] * design[m, i]
            normal[k, m] = total
            normal[m, k] = total
