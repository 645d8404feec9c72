"""Results with a whole budget, its Monte-Carlo check and single-joint sweeps, made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from reports.results import Results
from tests.support.reports import session as made

LINES = (
    ("pixels", "random", "A", 234.0, 0.30),
    ("camera skew", "random", "A", 234.0, 0.10),
    ("readings' noise", "random", "A", 234.0, 0.20),
    ("encoder resolution", "random", "B", np.inf, 0.05),
    ("encoder time stamps", "random", "B", np.inf, 0.05),
    ("autocorrelation", "random", "A", 234.0, 0.10),
    ("lack of fit", "random", "A", 234.0, 0.10),
    ("rig", "systematic", "B", 40.0, 0.70),
    ("robot base", "systematic", "B", 40.0, 0.40),
    ("clock", "systematic", "A", np.inf, 1e-6),
    ("alignment of the two instants", "systematic", "B", np.inf, 0.02),
    ("correlation of sources", "systematic", "B", np.inf, -0.30),
)


def holding() -> Results:
    """A budget that Monte Carlo confirms; every joint swept alone and sound."""
    return _with(_check([]), [_sweep(joint) for joint in range(1, 7)])


def failing() -> Results:
    """Linear propagation fails at a few pairs; sweeps show one fault each."""
    fails = [
        {"frame": 12, "joints": [4, 6], "ratio": [1.31, 1.22], "coupled": False,
         "unreachable": 0.0},
        {"frame": 31, "joints": [3], "ratio": [None], "coupled": False, "unreachable": 0.31},
        {"frame": 44, "joints": [4, 6], "ratio": [2.4, 2.6], "coupled": True, "unreachable": 0.0},
    ]  # fmt: skip
    sweeps = [
        _sweep(1, gain=0.005),
        _sweep(2, hysteresis_deg=-0.301),
        _sweep(3, eccentricity_deg=0.21, eccentricity_standard_uncertainty_deg=0.02,
               eccentricity_phase_deg=14.0, eccentricity_beyond_chance=True),
        _sweep(4, nonlinearity_p_value=1e-9, nonlinearity_rms_deg=0.081),
        _sweep(5, wobble_p_value=1e-7, wobble_rms_mm=0.31, wobble_rms_deg=0.09,
               outlying_frames=[207, 219]),
        _sweep(6, hysteresis_deg=None, hysteresis_standard_uncertainty_deg=None,
               both_directions=False),
    ]  # fmt: skip
    return _with(_check(fails), sweeps)


def failing_at(joints: list[int], *, coupled: bool) -> Results:
    """Linear propagation fails at one pair: for one joint, or for joints that enter no figure."""
    fails = {"frame": 4, "joints": joints, "ratio": [2.4] * len(joints), "unreachable": 0.0}
    return _with(_check([fails | {"coupled": coupled}]), [_sweep(3)])


def _with(check: dict[str, Any], sweeps: list[dict[str, Any]]) -> Results:
    plain = made.nonconforming()
    summary = dict(plain.summary)
    joints = [
        {
            "joint": row["joint"],
            "random_standard_uncertainty_deg": 0.4 * row["standard_uncertainty_deg"],
            "systematic_standard_uncertainty_deg": 0.9 * row["standard_uncertainty_deg"],
            "effective_degrees_of_freedom": None if row["joint"] == 1 else 61.3,
            "coverage_factor": 2.0,
            "sources": [],
        }
        for row in summary["joints"]
    ]
    summary |= {
        "budget": {"uncounted": ["robot table"], "joints": joints, "monte_carlo": check},
        "sweeps": sweeps,
    }
    tables = plain.tables | {
        "budget": _lines(summary["joints"]),
        "budget_parameters": _parameters(),
        "sweeps": _pairs(sweeps),
    }
    return replace(plain, summary=summary, tables=tables)


def _lines(rows: list[dict[str, Any]]) -> pd.DataFrame:
    names = ["source", "kind", "type", "degrees_of_freedom", "part"]
    joints = pd.DataFrame(rows)[["joint", "standard_uncertainty_deg"]]
    lines = joints.merge(pd.DataFrame(LINES, columns=names), how="cross")
    lines["standard_uncertainty_deg"] *= lines["part"]
    return lines.assign(share=lines["part"] * lines["part"].abs())


def _parameters() -> pd.DataFrame:
    sources = (
        ("rig", "right.mount_ry_deg", "deg", 0.002, np.inf),
        ("robot base", "robot_base.x_mm", "mm", 0.05, np.inf),
        ("clock", "clock_s", "s", 0.0005, np.inf),
        ("alignment of the two instants", "alignment_1", "1", 1.0, np.inf),
        ("robot table", "a2_mm", "mm", np.nan, np.nan),
        ("robot table", "alpha2_deg", "deg", np.nan, np.nan),
    )
    names = ["source", "parameter", "unit", "standard_uncertainty", "degrees_of_freedom"]
    joints = pd.DataFrame({"joint": range(1, 7), "type": "B"})
    rows = pd.DataFrame(sources, columns=names).merge(joints, how="cross")
    rows["sensitivity_deg"] = 0.13 * rows["joint"]
    contribution = rows["sensitivity_deg"] * rows["standard_uncertainty"]
    return rows.assign(contribution_deg=contribution)


def _check(fails: list[dict[str, Any]]) -> dict[str, Any]:
    joints = [
        {"joint": j, "pairs": 20, "holds": 20, "largest_difference": 0.004 * j, "of_mean": 0.001}
        for j in range(1, 7)
    ]
    return {
        "pairs": 22, "draws": 200, "seed": 1, "agrees_within": 0.05, "shifted_by_at_most": 0.1,
        "joints": joints, "fails": fails,
    }  # fmt: skip


def _sweep(joint: int, **other: Any) -> dict[str, Any]:
    return {
        "joint": joint, "pairs": 40, "first_frame": 40 * joint, "last_frame": 40 * joint + 39,
        "outlying_frames": [], "span_deg": 42.5, "both_directions": True, "gain": 0.0001,
        "gain_standard_uncertainty": 0.0002, "hysteresis_deg": 0.002,
        "hysteresis_standard_uncertainty_deg": 0.004, "eccentricity_deg": 0.04,
        "eccentricity_standard_uncertainty_deg": 0.05, "eccentricity_phase_deg": None,
        "eccentricity_phase_standard_uncertainty_deg": None, "eccentricity_beyond_chance": False,
        "nonlinearity_rms_deg": 0.012, "nonlinearity_rms_standard_uncertainty_deg": 0.001,
        "noise_rms_deg": 0.011, "nonlinearity_p_value": 0.4, "wobble_rms_mm": 0.05,
        "wobble_rms_deg": 0.03, "wobble_p_value": 0.6, **other,
    }  # fmt: skip


def _pairs(sweeps: list[dict[str, Any]]) -> pd.DataFrame:
    rng = np.random.default_rng(3)
    angle = 20 * np.sin(np.linspace(0, 2 * np.pi, 40))
    direction = np.where(np.gradient(angle) >= 0, 1.0, -1.0)
    pairs = pd.DataFrame({"frame": range(40), "angle_deg": angle, "direction": direction})
    parts = [
        pairs.assign(
            sweep=number, joint=sweep["joint"], error_deg=rng.normal(0.05 * direction, 0.01)
        )
        for number, sweep in enumerate(sweeps, start=1)
    ]
    return pd.concat(parts).assign(u_deg=0.01, curve_deg=lambda rows: 0.05 * rows["direction"])
