"""Budget, Monte-Carlo check, causes and sweeps as summary.json and tables have them.

Degrees, and the units of docs/results.md; null for what is not known.
"""

import math
from typing import Any

import numpy as np
import pandas as pd

from verify.analysis.diagnosis.causes import Cause, CauseCandidate
from verify.analysis.diagnosis.faults import UNIT_SCALES, Fault
from verify.analysis.sweeps.axis import UncertainValue
from verify.analysis.sweeps.sweeps import JointSweep
from verify.analysis.uncertainty.budget import Budget
from verify.analysis.uncertainty.monte_carlo import MAX_RATIO_ERROR, MAX_SHIFT, SEED, MonteCarlo
from verify.core.records import Array
from verify.core.statistics import correlation

MONTE_CARLO_COLUMNS = [
    "frame", "joint", "linear_u_deg", "monte_carlo_u_deg", "ratio", "shift", "coupled",
    "unreachable", "holds",
]  # fmt: skip
SWEEP_COLUMNS = [
    "sweep", "joint", "frame", "angle_deg", "direction", "error_deg", "u_deg", "curve_deg",
]  # fmt: skip


def budget_entry(found: Budget) -> dict[str, Any]:
    """What summary.json says of the budget: a joint's lines, their sum, and what is not in it."""
    lines, words = found.lines.to_dict("records"), ("source", "kind", "type")
    figures = ("standard_uncertainty_deg", "degrees_of_freedom", "share")
    joints = [
        {
            "joint": j + 1,
            "random_standard_uncertainty_deg": finite_number(np.rad2deg(found.random[j])),
            "systematic_standard_uncertainty_deg": finite_number(np.rad2deg(found.systematic[j])),
            "effective_degrees_of_freedom": finite_number(found.degrees[j]),
            "coverage_factor": finite_number(found.coverage_factor[j]),
            "sources": [
                {key: line[key] for key in words} | {k: finite_number(line[k]) for k in figures}
                for line in lines
                if line["joint"] == j + 1
            ],
        }
        for j in range(len(found.random))
    ]
    unstated = [
        {
            "source": effect.source, "error": effect.error, "joint": effect.joint + 1,
            "moves_mean_error_deg": float(np.rad2deg(effect.moved)), "text": str(effect),
        }
        for effect in found.unstated
    ]  # fmt: skip
    return {"uncounted": list(found.uncounted), "unstated": unstated, "joints": joints}


def monte_carlo_entry(found: MonteCarlo | None, frame: Array) -> dict[str, Any] | None:
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
                "largest_difference": finite_number(np.nanmax(away))
                if np.isfinite(away).any()
                else None,
                "of_mean": finite_number(found.mean_ratio[j] - 1),
            }
        )
    fails = [
        {
            "frame": int(frame[i]),
            "joints": (np.flatnonzero(~holds[m]) + 1).tolist(),
            "ratio": [finite_number(r) for r in found.ratio[m, ~holds[m]]],
            "coupled": bool(found.coupled[m, ~holds[m]].all()),
            "unreachable": finite_number(found.unreachable[m]),
        }
        for m, i in enumerate(found.pairs.tolist())
        if not holds[m].all()
    ]
    return {
        "pairs": len(found.pairs),
        "draws": found.draws,
        "seed": SEED,
        "agrees_within": MAX_RATIO_ERROR,
        "shifted_by_at_most": MAX_SHIFT,
        "joints": joints,
        "fails": fails,
    }


def monte_carlo_table(found: MonteCarlo | None, frame: Array) -> pd.DataFrame:
    """One row a checked pair and joint; `frame` (n,) numbers the compared pairs."""
    if found is None:
        return pd.DataFrame(columns=MONTE_CARLO_COLUMNS)
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
    return pd.DataFrame(dict(zip(MONTE_CARLO_COLUMNS, values, strict=True)))


def finite_number(value: Any) -> float | None:
    """A figure for JSON: null where it is not known or without bound."""
    return float(value) if value is not None and math.isfinite(value) else None


def correlation_entry(covariance: Array) -> list[list[float | None]]:
    """Correlations as rows for JSON."""
    return [[finite_number(value) for value in row] for row in correlation(covariance)]


def cause_entry(cause: Cause) -> dict[str, Any]:
    """One entry of `diagnosis`."""
    scale = UNIT_SCALES[cause.unit]
    entry: dict[str, Any] = {
        "joint": cause.joint,
        "kind": cause.kind,
        "value": finite_number(cause.value * scale),
        "unit": cause.unit or None,
        "standard_uncertainty": finite_number(cause.standard_uncertainty * scale),
        "expanded_uncertainty": finite_number(2 * cause.standard_uncertainty * scale),
        "explains": cause.explains,
    }
    if cause.candidates:
        entry["candidates"] = [_candidate(c) for c in cause.candidates]
        entry["separating_motion"] = cause.motion
        entry["separating_joints"] = list(cause.joints)
    else:
        entry |= _extra_fields(cause.fault)
        entry |= {"per_turn_candidates": list(cause.waves)} if cause.waves else {}
        entry |= {f"{what}_deg": math.degrees(angle) for what, angle in cause.details.items()}
    if cause.runner_up is not None:
        entry["runner_up"] = _candidate(cause.runner_up) | {"advantage": cause.runner_up.advantage}
    return entry


def _candidate(candidate: CauseCandidate) -> dict[str, Any]:
    scale = UNIT_SCALES[candidate.fault.unit]
    return {
        "joint": candidate.joint,
        "kind": candidate.kind,
        **_extra_fields(candidate.fault),
        "value": finite_number(candidate.value * scale),
        "unit": candidate.fault.unit or None,
        "expanded_uncertainty": finite_number(2 * candidate.standard_uncertainty * scale),
    }


def _extra_fields(fault: Fault) -> dict[str, Any]:
    more: dict[str, Any] = {}
    if fault.parameter is not None:
        more["parameter"] = fault.parameter
    if fault.per_turn is not None:
        more["per_turn"] = fault.per_turn
    if fault.begin is not None:
        more["t_s"] = fault.begin
    return more


def sweep_entries(found: list[JointSweep], frame: Array) -> list[dict[str, Any]]:
    """One entry a sweep for summary.json; `frame` (n,) numbers the compared pairs."""
    return [
        {
            "joint": sweep.joint + 1,
            "pairs": len(sweep.rows),
            "first_frame": int(frame[sweep.rows[0]]),
            "last_frame": int(frame[sweep.rows[-1]]),
            "outlying_frames": [int(f) for f in frame[sweep.outlying]],
            "span_deg": finite_number(np.rad2deg(np.ptp(sweep.q))),
            "both_directions": len(np.unique(sweep.direction)) > 1,
            "gain": finite_number(sweep.gain.value),
            "gain_standard_uncertainty": finite_number(sweep.gain.uncertainty),
            **_figure_entry("hysteresis", sweep.hysteresis),
            **_figure_entry("eccentricity", sweep.eccentricity),
            **_figure_entry("eccentricity_phase", sweep.phase),
            "eccentricity_beyond_chance": sweep.eccentric,
            **_figure_entry("nonlinearity_rms", sweep.nonlinearity),
            "noise_rms_deg": finite_number(np.rad2deg(sweep.noise)),
            "nonlinearity_p_value": finite_number(sweep.nonlinear_p),
            "wobble_rms_mm": finite_number(sweep.wobble[0] * 1e3),
            "wobble_rms_deg": finite_number(np.rad2deg(sweep.wobble[1])),
            "wobble_p_value": finite_number(sweep.wobble_p),
        }
        for sweep in found
    ]


def _figure_entry(name: str, figure: UncertainValue) -> dict[str, float | None]:
    return {
        f"{name}_deg": finite_number(np.rad2deg(figure.value)),
        f"{name}_standard_uncertainty_deg": finite_number(np.rad2deg(figure.uncertainty)),
    }


def sweeps_table(found: list[JointSweep], frame: Array) -> pd.DataFrame:
    """One row a pair of a sweep; `frame` (n,) numbers the compared pairs."""
    rows = []
    for number, sweep in enumerate(found, start=1):
        columns = (
            frame[sweep.rows], np.rad2deg(sweep.q), sweep.direction, np.rad2deg(sweep.error),
            np.rad2deg(sweep.uncertainty), np.rad2deg(sweep.curve),
        )  # fmt: skip
        rows += [(number, sweep.joint + 1, *values) for values in zip(*columns, strict=True)]
    return pd.DataFrame(rows, columns=SWEEP_COLUMNS)
