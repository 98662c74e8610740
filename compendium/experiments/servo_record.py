"""The record of the wide inference of §5.4, three quarters of an hour of work, and what it shows.

``python -m benchmarks.servo_inference`` writes it; the book reads it and remakes a small piece.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from compendium.experiments.servo_inference import NUMBERS, Problem, printed
from compendium.experiments.servo_loop import PATH_READINGS, STEP_READINGS
from compendium.experiments.servo_models import priors
from compendium.experiments.servo_predictions import uniform
from compendium.experiments.servo_sampler import Posterior, infer
from compendium.ledger import claim

PATH = Path(__file__).resolve().parents[2] / "data" / "inference" / "section_5_4.json"
#: The piece that is remade each time: model, seed, particles.
SMALL: tuple[str, int, int] = ("base", 54, 90)
#: The model that explains the numbers best; it was thought of after the misfit had been seen.
FAVORED = "start off the path"
#: Probability below which a calibration is not believed, shared by the numbers of a model.
LEVEL = 0.05
#: Deviation of a log evidence from seed to seed up to which it counts as known.
STEADY = 0.5


@cache
def record() -> dict[str, Any]:
    """Return what `benchmarks.servo_inference` measured."""
    return json.loads(PATH.read_text(encoding="utf-8"))


def small_piece() -> Posterior:
    """Make the small piece of the record anew."""
    model, seed, particles = SMALL
    return infer(Problem(model, printed()), seed, particles)


def agrees() -> bool:
    """Whether the small piece, made anew, is the one of the record within its Monte Carlo error.

    Another processor's last bits send the chains elsewhere. Of ninety states of standard normal
    numbers mean and deviation scatter by 0.1 to 0.2, and the log evidence by one.
    """
    off = np.abs(np.subtract(summary(small_piece()), record()["small"]))
    return bool(off[0] < 3 and (off[1:] < 0.7).all())


def summary(posterior: Posterior) -> list[float]:
    """Return the evidence, and mean and deviation of each unknown, as the record keeps them."""
    normal = posterior.normal
    every = [posterior.log_evidence, *normal.mean(axis=0), *normal.std(axis=0)]
    return [round(float(value), 9) for value in every]


def evidence() -> pd.DataFrame:
    """Return how well each model explains the eighteen numbers, the best first.

    Returns
    -------
    pandas.DataFrame
        Mean of the log evidence over the seeds, least and largest, their deviation, and the mean
        over that of the base.
    """
    rows = []
    found = record()["evidence"]
    for model, logs in found.items():
        over = np.mean(logs) - np.mean(found["base"])
        rows.append((model, np.mean(logs), min(logs), max(logs), np.std(logs, ddof=1), over))
    columns = ["model", "log evidence", "least", "largest", "deviation", "over the base"]
    table = pd.DataFrame(rows, columns=columns)
    return table.sort_values("log evidence", ascending=False, ignore_index=True)


def held() -> pd.DataFrame:
    """Return which printed numbers lie in their intervals; a row each number, a column a model."""
    numbers = printed()
    return pd.DataFrame(
        {
            model: [low <= y <= high for (low, _, high), y in zip(ends, numbers, strict=True)]
            for model, ends in record()["left out"].items()
        },
        index=list(NUMBERS),
    )


def left_out() -> dict[str, Any]:
    """Return what `figures.inference.draw_left_out` takes."""
    names = [claim(id).what for id in NUMBERS]
    return {"names": names, "printed": printed(), "intervals": record()["left out"]}


def left_out_table() -> pd.DataFrame:
    """Return each number beside its intervals, and ``outside`` where it is; the counts last."""
    inside = held()
    rows = []
    for place, id in enumerate(NUMBERS):
        row = {"number": claim(id).what, "printed": f"{claim(id).printed} {claim(id).unit}"}
        for model, ends in record()["left out"].items():
            low, _, high = ends[place]
            mark = "" if inside.loc[id, model] else " outside"
            row[model] = f"{_short(low)} to {_short(high)}{mark}"
        rows.append(row)
    counts = {str(model): f"{inside[model].sum()} of {len(NUMBERS)}" for model in inside}
    rows.append({"number": "inside", "printed": "", **counts})
    return pd.DataFrame(rows)


def never_held() -> list[str]:
    """Return what the numbers are that lie outside in every leading model."""
    inside = held()
    return [claim(str(id)).what for id in inside.index[~inside.any(axis=1)]]


def calibration() -> pd.DataFrame:
    """Return, for each model tried, how uniform the ranks of its least uniform number are.

    Returns
    -------
    pandas.DataFrame
        Data sets, unknown numbers, the least uniform of them, its probability, whether all are
        believed (at `LEVEL` over the count of numbers), and the ranks' deviation over that of
        uniform ones, the mean over the numbers: above one, the posteriors are too narrow.
    """
    rows = []
    for model, tried in record()["calibration"].items():
        ranks = np.array(tried["ranks"])
        chance = uniform(ranks)
        worst = int(chance.argmin())
        believed = "yes" if chance[worst] > LEVEL / len(chance) else "no"
        spread = np.sqrt(12) * ranks.std(axis=0).mean()
        least = tried["names"][worst]
        rows.append((model, len(ranks), len(chance), least, chance[worst], believed, spread))
    columns = [
        "model",
        "data sets",
        "numbers",
        "least uniform",
        "probability",
        "uniform",
        "deviation",
    ]
    return pd.DataFrame(rows, columns=columns)


def widths(model: str) -> pd.Series:
    """Return the deviation of each number after over that before, of the standard normal ones."""
    kept = record()["posterior"][model]
    return pd.Series(kept["widths"], index=kept["names"])


def trades(model: str) -> dict[str, Any]:
    """Return what `figures.inference.draw_trades` takes."""
    kept = record()["posterior"][model]
    return {"names": kept["names"], "correlation": kept["correlation"]}


def quantiles() -> pd.DataFrame:
    """Return median and ends of 90 % of every unknown number, a row each, a column each model."""
    columns = {}
    for model, kept in record()["posterior"].items():
        columns[model] = {
            name: f"{_short(middle)} ({_short(low)} to {_short(high)})"
            for name, (low, middle, high) in zip(kept["names"], kept["quantiles"], strict=True)
        }
    return pd.DataFrame(columns).fillna("")


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def reading_table(model: str, most: int = 4) -> pd.DataFrame:
    """Return the likeliest readings of the words of either table, with their probabilities."""
    rows = []
    kept = record()["posterior"][model]
    for what, names, shares in (
        ("Table 5.3", STEP_READINGS, kept["steps"]),
        ("Table 5.4", PATH_READINGS, kept["paths"]),
    ):
        for place in np.argsort(shares)[::-1][:most]:
            texts = [f"{part:.0%}" if isinstance(part, float) else part for part in names[place]]
            rows.append((what, ", ".join(texts), shares[place]))
    return pd.DataFrame(rows, columns=["words of", "reading", "probability"])


def band_shares(model: str) -> dict[float, float]:
    """Return how likely each settling band is."""
    shares: dict[float, float] = {}
    for (band, *_), share in zip(STEP_READINGS, record()["posterior"][model]["steps"], strict=True):
        shares[band] = shares.get(band, 0.0) + share
    return shares


def findings() -> list[tuple[str, float, str, int]]:
    """Return what the text of section 5.4 quotes: name, value, unit, decimal places."""
    kept, table = record(), evidence().set_index("model")
    found = [(f"over-{model}", table.loc[model, "over the base"], "", 1) for model in table.index]
    found.append(("evidence-deviation", table["deviation"].max(), "", 2))
    found += [(f"inside-{model}", held()[model].sum(), "", 0) for model in held()]
    found += [
        (f"band-{100 * band:g}", 100 * share, "%", 0)
        for band, share in band_shares(FAVORED).items()
    ]
    found += [
        (f"rank-deviation-{model}", spread, "", 2)
        for model, spread in calibration().set_index("model")["deviation"].items()
    ]
    favored = kept["posterior"][FAVORED]
    place = PATH_READINGS.index(("next reference", "of the distance"))
    found.append(("next-reference", 100 * favored["paths"][place], "%", 0))
    for prior, (low, _, high) in zip(priors(FAVORED), favored["quantiles"], strict=True):
        digits = max(0, 1 - int(np.floor(np.log10(abs(low)))))  # two of the smaller end
        unit = prior.unit
        found += [
            (f"{prior.name}-low", low, unit, digits),
            (f"{prior.name}-high", high, unit, digits),
        ]
    return [
        (f"5.4/{name.replace(' ', '-')}", float(value), unit, digits)
        for name, value, unit, digits in found
    ]
