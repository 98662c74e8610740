"""The modulus of one dimple by several models of the membrane."""

from __future__ import annotations

import warnings
from contextlib import suppress
from typing import Any

from microlib._common import as_poisson_ratio, as_scalar, positive_scalars
from microlib.membrane._point_load import SmallSlopeWarning, elastic_modulus
from microlib.membrane.large._capsule import capsule_modulus
from microlib.membrane.large._disc import disc_modulus


def model_moduli(
    force: float,
    rim_radius: float,
    dimple_depth: float,
    *,
    thickness: float,
    probe_half_width: float,
    poisson_ratio: float,
    capsule_radius: float | None = None,
) -> dict[str, float]:
    """Return the elastic modulus of one dimple by each model that has a solution.

    Parameters
    ----------
    force, rim_radius, dimple_depth, thickness, probe_half_width, poisson_ratio : float
        As for `elastic_modulus`: µN, µm, and no unit for the last.
    capsule_radius : float, optional
        Radius of a closed capsule, in µm. Without it, the capsule is not among the models.

    Returns
    -------
    dict of str to float
        Modulus in MPa by the name of the model: the point load (5.2), a flat disc with and without
        the pressure F/(π a²), and a closed capsule. Discs and capsules have a neo-Hookean and a
        Hookean law; the neo-Hookean law has the Poisson ratio 0.5. A model that has no equilibrium
        with this dimple is left out.

    Raises
    ------
    ValueError
        As for `elastic_modulus`, or if `capsule_radius` is not positive.

    Notes
    -----
    The point load assumes a uniform stress, which a clamped membrane does not have. In the limit of
    small slopes, for c/a = 0.1 and ν = 0.5, the modulus of a disc with pressure is 0.40 of that of
    the point load, and without pressure 0.67. The :ref:`table of models <which-model>` says which
    model suits which dimple.

    Examples
    --------
    >>> from microlib.membrane import model_moduli
    >>> sizes = {"thickness": 3.0, "probe_half_width": 25.0, "poisson_ratio": 0.5}
    >>> for model, modulus in model_moduli(1.0, 250.0, 20.0, **sizes).items():
    ...     print(f"{model}: {modulus:.2f} MPa")
    point load: 1.55 MPa
    disc, neo-hooke: 0.63 MPa
    disc, neo-hooke, no pressure: 1.04 MPa
    disc, hooke: 0.63 MPa
    disc, hooke, no pressure: 1.04 MPa
    """
    dimple = positive_scalars(force=force, rim_radius=rim_radius, dimple_depth=dimple_depth)
    sides = {"thickness": thickness, "probe_half_width": probe_half_width}
    lengths: dict[str, Any] = dict(zip(sides, positive_scalars(**sides), strict=True))
    poisson_ratio = as_poisson_ratio(poisson_ratio)
    if capsule_radius is not None:
        capsule_radius = as_scalar("capsule_radius", capsule_radius, above=0)
    with warnings.catch_warnings(action="ignore", category=SmallSlopeWarning):
        point_load = elastic_modulus(*dimple, **lengths, poisson_ratio=poisson_ratio)
    moduli = {"point load": float(point_load)}
    for law, ratio in (("neo-hooke", 0.5), ("hooke", poisson_ratio)):
        settings: dict[str, Any] = {"law": law, "poisson_ratio": ratio, **lengths}
        for suffix, pressure in (("", "balance"), (", no pressure", 0.0)):
            with suppress(ValueError):  # no such disc has this dimple
                moduli[f"disc, {law}{suffix}"] = disc_modulus(
                    *dimple, pressure=pressure, **settings
                )
        if capsule_radius is not None:
            with suppress(ValueError):  # no such capsule has this dimple
                capsule = capsule_modulus(*dimple, capsule_radius=capsule_radius, **settings)
                moduli[f"capsule, {law}"] = float(capsule.modulus)
    return moduli
