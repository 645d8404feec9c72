"""A budget and its Monte-Carlo check as summary.json and tables have them, in degrees."""

import math
from typing import Any

import numpy as np
import pandas as pd

from verify.judgement.budget import COLUMNS, Budget
from verify.judgement.monte_carlo import AGREES, SEED, SHIFTED, MonteCarlo
from verify.records import Array

DRAWN_COLUMNS = [
    "frame", "joint", "linear_u_deg", "monte_carlo_u_deg", "ratio", "shift", "coupled",
    "unreachable", "holds",
]  # fmt: skip


def budget_entry(found: Budget, uncounted: tuple[str, ...]) -> dict[str, Any]:
    """What summary.json says of the budget: a joint's lines, and what they add up to."""
    columns = [found.lines[name].tolist() for name in COLUMNS]
    lines = [dict(zip(COLUMNS, line, strict=True)) for line in zip(*columns, strict=True)]
    joints = [
        {
            "joint": j + 1,
            "random_standard_uncertainty_deg": known(np.rad2deg(found.random[j])),
            "systematic_standard_uncertainty_deg": known(np.rad2deg(found.systematic[j])),
            "effective_degrees_of_freedom": known(found.degrees[j]),
            "coverage_factor": known(found.coverage_factor[j]),
            "sources": [_source(line) for line in lines if line["joint"] == j + 1],
        }
        for j in range(len(found.random))
    ]
    return {"uncounted": list(uncounted), "joints": joints}


def _source(line: dict[str, Any]) -> dict[str, Any]:
    """One line of a joint's budget."""
    return {
        "source": line["source"],
        "kind": line["kind"],
        "type": line["type"],
        "standard_uncertainty_deg": known(line["standard_uncertainty_deg"]),
        "degrees_of_freedom": known(line["degrees_of_freedom"]),
        "share": known(line["share"]),
    }


def drawn_entry(found: MonteCarlo | None, frame: Array) -> dict[str, Any] | None:
    """What summary.json says of the Monte-Carlo check; `frame` (n,) numbers the compared pairs."""
    if found is None:
        return None
    holds = found.holds
    joints = []
    for j in range(holds.shape[1]):
        told = ~found.coupled[:, j]
        away = np.abs(found.ratio[told, j] - 1)
        joints.append(
            {
                "joint": j + 1,
                "pairs": int(told.sum()),
                "holds": int(holds[told, j].sum()),
                "largest_difference": known(np.nanmax(away)) if np.isfinite(away).any() else None,
                "of_mean": known(found.mean_ratio[j] - 1),
            }
        )
    fails = [
        {
            "frame": int(frame[i]),
            "joints": (np.flatnonzero(~holds[m]) + 1).tolist(),
            "ratio": [known(r) for r in found.ratio[m, ~holds[m]]],
            "coupled": bool(found.coupled[m, ~holds[m]].all()),
            "unreachable": known(found.unreachable[m]),
        }
        for m, i in enumerate(found.pairs.tolist())
        if not holds[m].all()
    ]
    return {
        "pairs": len(found.pairs),
        "draws": found.draws,
        "seed": SEED,
        "agrees_within": AGREES,
        "shifted_by_at_most": SHIFTED,
        "joints": joints,
        "fails": fails,
    }


def drawn_table(found: MonteCarlo | None, frame: Array) -> pd.DataFrame:
    """One row a checked pair and joint; `frame` (n,) numbers the compared pairs."""
    if found is None:
        return pd.DataFrame(columns=DRAWN_COLUMNS)
    m, j = found.ratio.shape
    values = [
        np.repeat(frame[found.pairs], j),
        np.tile(np.arange(1, j + 1), m),
        np.rad2deg(found.linear).ravel(),
        np.rad2deg(found.drawn).ravel(),
        found.ratio.ravel(),
        found.shift.ravel(),
        found.coupled.ravel(),
        np.repeat(found.unreachable, j),
        found.holds.ravel(),
    ]
    return pd.DataFrame(dict(zip(DRAWN_COLUMNS, values, strict=True)))


def known(value: Any) -> float | None:
    """A figure for JSON: null where it is not known or without bound."""
    number = float(value)
    return number if math.isfinite(number) else None
