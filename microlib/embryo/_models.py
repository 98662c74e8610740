"""What modulus one dimple has by each model: how much of it is the model's choice."""

from __future__ import annotations

import warnings
from typing import Any

from microlib.membrane import SmallSlopeWarning, capsule_modulus, disc_modulus, elastic_modulus

__all__ = ["moduli_by_model"]


def moduli_by_model(
    force: float,
    rim_radius: float,
    depth: float,
    *,
    radius: float | None,
    poisson_ratio: float,
    **sizes: float,
) -> dict[str, float]:
    """Return the modulus of a dimple by each model that can have it.

    Parameters
    ----------
    force : float
        Force F, in µN.
    rim_radius, depth : float
        a and w_d, in µm.
    radius : float or None
        Radius of a capsule before the test, in µm; None leaves capsules out.
    poisson_ratio : float
        Of (4.7) and of Hooke's law; the other law is incompressible.
    **sizes : float
        thickness and probe_half_width, in µm.

    Returns
    -------
    dict of str to float
        Moduli in MPa by the model's name: ``"point load"`` for (4.7), ``"disc"`` with and without
        the pressure F/(π a²), and ``"capsule"``, by law.
    """
    with warnings.catch_warnings():
        # Whoever compares the models sees that this one takes its slopes for small.
        warnings.simplefilter("ignore", SmallSlopeWarning)
        formula = elastic_modulus(force, rim_radius, depth, **sizes, poisson_ratio=poisson_ratio)
    found = {"point load": float(formula)}
    for law, ratio in (("neo-hooke", 0.5), ("hooke", poisson_ratio)):
        settings: dict[str, Any] = {"law": law, "poisson_ratio": ratio, **sizes}
        for name, pressure in ((f"disc, {law}", "balance"), (f"disc, {law}, no pressure", 0.0)):
            try:
                found[name] = disc_modulus(force, rim_radius, depth, pressure=pressure, **settings)
            except ValueError:
                continue  # no such disc has this dimple
        if radius is None:
            continue
        try:
            shell = capsule_modulus(force, rim_radius, depth, radius=radius, **settings)
        except ValueError:
            continue  # nor has a capsule
        found[f"capsule, {law}"] = shell.modulus
    return found
