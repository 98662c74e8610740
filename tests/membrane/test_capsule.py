"""The closed capsule, against spheres, plates, its own energy and a minimum of that energy."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve

from microlib.membrane import capsule_modulus, indent_capsule
from tests.membrane.energy import stored, stresses

R, H, C = 600.0, 3.0, 25.0
SHELL: dict[str, Any] = {"capsule_radius": R, "thickness": H, "probe_half_width": C}
SHELL |= {"poisson_ratio": 0.5}
CAPSULE = SHELL | {"modulus": 1.0}
SPHERE = 4 / 3 * np.pi * R**3
STATES = [
    ("neo-hooke", 1.05, 100.0),
    ("mooney-rivlin", 1.10, 197.24),
    ("hooke", 1.0, 60.0),
    # The slack middle of the plate is about to vanish.
    ("neo-hooke", 1.01, 121.54),
    ("neo-hooke", 1.01, 123.08),
]


# A second method: nodes, straight elements, and Newton on the energy with a multiplier for the
# volume and springs below the plate. It shares nothing with the library.


def solve(matrix: Any, right: Any) -> Any:
    return spsolve(csc_array(matrix), right)


def relaxed_slopes(c2: float, l1: Any, l2: Any) -> tuple[Any, Any]:
    """Slopes of the relaxed energy of rubber, C₂/C₁ = c2, modulus 1."""
    scale = 1 / (3 * (1 + c2))

    def strip(stretch: Any) -> Any:
        return scale * (1 + c2 / stretch) * (stretch - stretch**-2)

    one = scale * (1 + c2 * l2**2) * (l1 - l1**-3 * l2**-2)
    two = scale * (1 + c2 * l1**2) * (l2 - l2**-3 * l1**-2)
    slack = (l1.real < 1) & (l2.real < 1)
    first, second = (l2.real < l1.real**-0.5), (l1.real < l2.real**-0.5)
    # One in a thousand of the full law keeps slack and wrinkled parts determined.
    rest = 1e-3
    a = np.where(slack, 0, np.where(first, strip(l1), np.where(second, 0, one)))
    b = np.where(slack, 0, np.where(second, strip(l2), np.where(first, 0, two)))
    return a + rest * (one - a), b + rest * (two - b)


def minimised_state(approach: float, inflation: float, c2: float, elements: int) -> NDArray:
    """F/(E h R) and approach/R of a bonded punch on a plate, less what its springs yield."""
    c, stiff, soft = C / R, 3e4, 3e-5
    edge = np.arcsin(c)
    half = np.linspace(0, 1, elements // 2 + 1)
    upper = np.pi - (np.pi / 2) * (edge / (np.pi / 2)) ** half
    s = np.concatenate([half[:-1] * np.pi / 2, upper])
    n = s.size
    width = np.diff(s) / inflation
    middle = np.sin((s[1:] + s[:-1]) / 2) / inflation
    area = 2 * np.pi * middle * width
    per_node = np.append(area, 0) / 2 + np.append(0, area) / 2

    def bulge(ends: Any) -> Any:
        r0, z0, r1, z1 = ends
        dz, square = z1 - z0, r0**2 + r0 * r1 + r1**2
        return np.pi / 3 * np.array([(2 * r0 + r1) * dz, -square, (r0 + 2 * r1) * dz, square])

    def slopes(ends: Any, p: float) -> Any:
        r0, z0, r1, z1 = ends
        dr, dz, r = r1 - r0, z1 - z0, (r0 + r1) / 2
        long = (dr**2 + dz**2) ** 0.5
        one, two = relaxed_slopes(c2, long / width, r / middle)
        along, across = area * one / (width * long), area * two / (2 * middle)
        pull = np.array([-along * dr + across, -along * dz, along * dr + across, along * dz])
        return pull - p * bulge(ends)

    nodes = np.arange(n - 1)
    places = np.array([nodes, nodes + n, nodes + 1, nodes + 1 + n])
    end = 2 * n - 1
    free = np.append(np.setdiff1d(np.arange(2 * n), [0, n - 1, end]), 2 * n)

    def residual(q: Any) -> Any:
        ends, z, out = q[places], q[n : 2 * n], np.zeros(2 * n + 1)
        np.add.at(out, places, slopes(ends, q[-1]))
        out[n : 2 * n] -= stiff * soft * per_node * np.logaddexp(0, -z / soft)
        r0, z0, r1, z1 = ends
        out[-1] = 4 / 3 * np.pi - np.sum(np.pi / 3 * (r0**2 + r0 * r1 + r1**2) * (z1 - z0))
        return out

    def tangent(q: Any) -> Any:
        matrix, swept, ends = np.zeros((2 * n + 1, 2 * n + 1)), np.zeros(2 * n), q[places]
        for k in range(4):
            moved = ends.astype(complex)
            moved[k] += 1e-30j
            np.add.at(matrix, (places, places[k]), slopes(moved, q[-1]).imag / 1e-30)
        np.add.at(swept, places, bulge(ends))
        matrix[-1, :-1] = matrix[:-1, -1] = -swept
        z = np.arange(n, 2 * n)
        matrix[z, z] += stiff * per_node / (1 + np.exp(np.clip(q[z] / soft, -50, 50)))
        return matrix

    even = np.array(inflation)
    p = 2 * float(relaxed_slopes(c2, even, even)[0]) / inflation
    q = np.concatenate([np.sin(s), 1 - np.cos(s), [p]])
    for height in np.linspace(q[end], 2 - approach, 13)[1:]:
        matrix = tangent(q)
        shift = height - q[end]
        q[free] -= solve(matrix[np.ix_(free, free)], matrix[free, end] * shift)
        q[end] = height
        for _ in range(60):
            left = residual(q)[free]
            step = solve(tangent(q)[np.ix_(free, free)], -left)
            for power in range(12):
                trial = q.copy()
                trial[free] += step / 2**power
                if np.linalg.norm(residual(trial)[free]) < np.linalg.norm(left):
                    break
            q = trial
            if np.abs(step[:-1]).max() < 1e-10:
                break
        else:
            raise AssertionError("the minimum was not found")
    return np.array([-residual(q)[end], approach + q[n]])


@pytest.mark.parametrize(
    ("law", "inflation", "force"),
    [("neo-hooke", 1.05, 100.0), ("mooney-rivlin", 1.1, 197.24), ("neo-hooke", 1.01, 60.0)],
)
def test_force_and_approach_match_energy_minimum(law: str, inflation: float, force: float) -> None:
    settings = {**CAPSULE, "law": law, "inflation": inflation}
    guide = indent_capsule(force, **settings).approach / R
    c2 = 0.2 if law == "mooney-rivlin" else 0.0
    found = [minimised_state(guide, inflation, c2, n) for n in (120, 240)]
    # The error of straight elements falls with the square of their number.
    load, approach = found[1] + (found[1] - found[0]) / 3
    assert abs(found[1][0] - found[0][0]) < 2e-2 * load
    got = indent_capsule(load * H * R, **settings).approach / R
    # At the smallest tension the springs below the plate are not quite hard.
    assert got == pytest.approx(approach, rel=1e-4 if inflation > 1.01 else 4e-4)


@pytest.mark.parametrize("law", ["hooke", "neo-hooke", "mooney-rivlin"])
def test_state_approaches_sphere_for_vanishing_force(law: str) -> None:
    settings = {**CAPSULE, "law": law, "inflation": 1.08, "probe_half_width": 0.5}
    # The pressure in a sphere is 2 h N/(λ R), with the nominal stress N of each law.
    stress = {
        "hooke": 0.08 / (1 - 0.5),
        "neo-hooke": (1.08 - 1.08**-5) / 3,
        "mooney-rivlin": (1.08 - 1.08**-5) * (1 + 0.2 * 1.08**2) / 3.6,
    }[law]
    pressure = 2 * H * stress / (1.08 * R)
    state = indent_capsule(1.1 * np.pi * 0.5**2 * pressure, **settings)
    assert state.pressure == pytest.approx(pressure, rel=1e-5)
    assert 0 < state.approach < 0.02
    assert 0 < state.depth < 1e-3


@pytest.mark.parametrize(("law", "inflation", "force"), STATES)
def test_volume_is_kept_force_is_energy_slope_and_crest_is_rim(
    law: str, inflation: float, force: float
) -> None:
    settings = {**CAPSULE, "law": law, "inflation": inflation}
    less, state, more = (indent_capsule(k * force, **settings) for k in (0.98, 1.0, 1.02))
    # Straight parts between the nodes, of which there are 400 or more.
    volume = abs(np.trapezoid(np.pi * state.r**2, state.z))
    assert volume == pytest.approx(SPHERE, rel=2e-4)
    # F = dU/dδ: no pressure's work, the volume being kept. The wall on the probe keeps its energy.
    energies = [stored(each, law, CAPSULE["modulus"], H) for each in (less, more)]
    slope = (energies[1] - energies[0]) / (more.approach - less.approach)
    assert slope == pytest.approx(force, rel=1e-3)
    # The crest and the plate's contact have one radius, that which the pressure gives.
    a = np.sqrt(force / (np.pi * state.pressure))
    assert state.rim_radius == pytest.approx(a, rel=1e-12)
    crest = np.argmax(state.z)
    assert state.r[crest] == pytest.approx(min(a, state.r[crest]), rel=1e-6)
    assert state.z[crest] - state.z[0] == pytest.approx(state.depth, abs=1e-9 * R)
    assert state.approach == pytest.approx(2 * R - state.z[0], abs=1e-9 * R)
    assert np.ptp(state.z[state.r < 0.999 * a][-5:]) == 0
    assert state.stresses.min() >= -1e-12
    taut = np.isfinite(state.stretches[0])  # the middle of the plate may be slack
    wanted = stresses(law, state.stretches)
    # Where the wall is about to be slack, its differences err by a third of their step.
    np.testing.assert_allclose(state.stresses[:, taut], wanted[:, taut], atol=5e-7)


@pytest.mark.parametrize(
    ("law", "inflation", "modulus"),
    [("hooke", 1.048, 0.88), ("neo-hooke", 1.042, 1.12), ("mooney-rivlin", 1.040, 1.15)],
)
def test_capsule_modulus_inverts_indent_capsule_for_printed_dimple(
    law: str, inflation: float, modulus: float
) -> None:
    force, a, depth = 197.24, 246.95, 121.22
    shell = SHELL | {"law": law}
    found = capsule_modulus(force, a, depth, **shell)
    assert found.modulus == pytest.approx(modulus, rel=5e-3)
    assert found.inflation == pytest.approx(inflation, abs=1e-3)
    assert 1e3 * found.state.pressure == pytest.approx(1.0295, rel=1e-5)
    state = indent_capsule(force, modulus=found.modulus, inflation=found.inflation, **shell)
    assert (state.depth, state.rim_radius) == pytest.approx((depth, a), rel=1e-6)
    assert found.state.depth == pytest.approx(depth, rel=1e-9)


def test_capsule_modulus_allows_slack_middle() -> None:
    shell = SHELL | {"capsule_radius": 500.0}
    found = capsule_modulus(197.24, 246.95, 121.22, **shell)
    state = indent_capsule(197.24, modulus=found.modulus, inflation=found.inflation, **shell)
    assert state.depth == pytest.approx(121.22, rel=1e-5)
    assert np.isnan(found.state.stretches[:, -1]).all()
    assert not found.state.stresses[:, -1].any()
    assert found.modulus == pytest.approx(2.15, rel=0.03)


def test_uninflated_capsule_is_found() -> None:
    wall = SHELL | {"law": "hooke"}
    state = indent_capsule(30.0, modulus=0.7, **wall)
    found = capsule_modulus(30.0, state.rim_radius, state.depth, **wall)
    assert (found.modulus, found.inflation) == pytest.approx((0.7, 1.0), rel=1e-5)


def test_exponents_are_slopes_of_logarithm_of_modulus() -> None:
    lengths = {"rim_radius": 190.0, "depth": 68.0, "probe_half_width": C, "capsule_radius": R}
    known: dict[str, Any] = {"thickness": H, "poisson_ratio": 0.3, "law": "hooke"}
    exponents = capsule_modulus(100.0, **lengths, **known).exponents
    assert list(exponents) == list(lengths)
    for name, length in lengths.items():
        less, more = (
            capsule_modulus(100.0, **lengths | {name: by * length}, **known).modulus
            for by in (0.99, 1.01)
        )
        assert exponents[name] == pytest.approx(np.log(more / less) / 0.02, rel=0.02), name


@pytest.mark.parametrize(
    ("half_width", "inflation", "force"), [(60.0, 1.03, 40.0), (40.0, 1.05, 30.0)]
)
def test_dimple_of_two_capsules_is_rejected(
    half_width: float, inflation: float, force: float
) -> None:
    """Another inflation and modulus have the same force, rim and depth, or nearly so."""
    wall = SHELL | {"probe_half_width": half_width}
    state = indent_capsule(force, modulus=1.0, inflation=inflation, **wall)
    with pytest.raises(ValueError, match="the depth does not determine the modulus"):
        capsule_modulus(force, state.rim_radius, state.depth, **wall)


@pytest.mark.parametrize(
    ("force", "law", "inflation", "half_width", "message"),
    [
        (2000.0, "neo-hooke", 1.0, C, r"force must .*: the probe would reach the plate"),
        (2000.0, "hooke", 1.1, C, "the wall would touch the probe's side"),
        (1.0, "neo-hooke", 1.05, C, "got 1 µN: the wall would not be flat on the whole face"),
        (
            2.0,
            "neo-hooke",
            1.0,
            100.0,
            r"F/\(E h R\) = 0.0011; without an inflation, such as 1.001",
        ),
    ],
)
def test_impossible_force_raises(force, law, inflation, half_width, message) -> None:
    given = CAPSULE | {"law": law, "inflation": inflation, "probe_half_width": half_width}
    with pytest.raises(ValueError, match=message):
        indent_capsule(force, **given)


@pytest.mark.parametrize(
    ("rim", "depth", "message"),
    [
        (107.26, 0.1204, r"at w_d/a = 0.0011, c/a = 0.93, a/R = 0.18, where .* press deeper"),
        (150.0, 100.0, "w_d/a = 0.67, c/a = 0.67, a/R = 0.25, a dimple that probably no capsule"),
    ],
)
def test_error_of_an_unsolved_dimple_names_its_ratios_and_what_to_do(rim, depth, message) -> None:
    """The first is that of a capsule, inflated by 1.03."""
    with pytest.raises(ValueError, match=message):
        capsule_modulus(20.0, rim, depth, **SHELL | {"probe_half_width": 100.0})
