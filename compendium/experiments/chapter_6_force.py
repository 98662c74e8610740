"""Chapter 6: the force over time on a chorion that relaxes, read from its outlines."""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from compendium import thesis
from compendium.ledger import claim
from microlib.embryo import force_from_image
from microlib.membrane import SmallSlopeWarning, viscoelastic_force
from microlib.synthetic import Embryo, embryo_image

#: Share of the force that a held chorion loses, and how fast (s): an example, nobody measured it.
SHARE, RELAXATION_TIME = 0.4, 3.0
#: Instantaneous modulus, MPa.
MODULUS = claim("table-5.6/E").value
#: Ends of the push: the probe goes in, waits, and goes half of the way out (s), and the force that
#: the shape would have if nothing relaxed (µN).
_TURNS, _ELASTIC = (0.0, 2.0, 8.0, 10.0), (0.0, 150.0, 150.0, 60.0)
#: Below it the dimple is no deeper than what an image shows.
_LEAST_FORCE = 2.0
#: Standard deviations to either side that hold 95 % of a normal distribution.
_NORMAL_95 = 1.96


def elastic_push(time: ArrayLike) -> NDArray:
    """Return the force in µN that the shape at each time (s) would have if nothing had relaxed.

    Examples
    --------
    >>> elastic_push([1.0, 5.0, 10.0])
    array([ 75., 150.,  60.])
    """
    return np.interp(np.asarray(time, dtype=float), _TURNS, _ELASTIC)


def true_force(time: NDArray) -> NDArray:
    """Return the force in µN of a spring beside a spring and a dashpot in line, by Runge–Kutta.

    Examples
    --------
    >>> true_force(np.array([0.0, 2.0, 8.0])).round(1)
    array([  0. , 133.8,  95.9])
    """
    slopes = np.diff(_ELASTIC) / np.diff(_TURNS)

    def rate(t: float, held: NDArray) -> NDArray:
        part = min(int(np.searchsorted(_TURNS, t, side="right")) - 1, slopes.size - 1)
        return np.asarray(SHARE * slopes[part] - held / RELAXATION_TIME)

    reach = (float(time[0]), float(time[-1]))
    # Steps no longer than this see every turn.
    held = solve_ivp(rate, reach, [0.0], t_eval=time, rtol=1e-8, max_step=0.02).y[0]
    return np.asarray((1 - SHARE) * elastic_push(time) + held)


def relaxing_sequence(rng: np.random.Generator, time: NDArray) -> pd.DataFrame:
    """Read the force over time from rendered images of an embryo whose chorion relaxes.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of texture and noise.
    time : ndarray, shape (n,)
        Of the images, s, from 0 on.

    Returns
    -------
    pandas.DataFrame
        A row each image: time (s), true force, force with the ends low and high of its 95 %
        interval, and the force of its outline alone (elastic), NaN where it shows no dimple; µN.
    """
    elastic, std = np.zeros(time.size), np.zeros(time.size)
    for k, force in enumerate(elastic_push(time)):
        if force < _LEAST_FORCE:
            continue  # no dimple is seen, and no force is there
        embryo = Embryo.pressed(force, modulus=MODULUS, **thesis.MEMBRANE)
        scene = embryo_image(embryo, rng=rng, shape=(400, 640), center=(320.0, 130.0))
        seen = {"pixel_size": thesis.EMBRYO_PIXEL, **thesis.MEMBRANE}
        with warnings.catch_warnings():
            # The images obey the model by construction.
            warnings.simplefilter("ignore", SmallSlopeWarning)
            found = force_from_image(scene.image, MODULUS, direction="top", **seen)
        elastic[k], std[k] = found.force, found.force * found.relative_std
    # Column j is the force over time of a unit at time j: the law is linear in all of them.
    response = viscoelastic_force(
        time, np.eye(time.size), prony_coefficients=[SHARE], relaxation_times=[RELAXATION_TIME]
    ).T
    read, reach = response @ elastic, _NORMAL_95 * np.sqrt(response**2 @ std**2)
    forces = {"true": true_force(time), "force": read, "low": read - reach, "high": read + reach}
    return pd.DataFrame({"time": time, **forces, "elastic": np.where(std > 0, elastic, np.nan)})
