"""Results of the sample sessions, and what those do not show put into them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pandas as pd

from reports.results import Results
from tests.support.command import sample_results

FAULTY, SOUND = "multi_joint_fault_6r", "multi_joint_rv_3sd"
PAIRS, PERIOD = 60, 0.1  # of the first, s
LOST = {"too_few_leds": [20, 21, 22], "outlier": [7, 33], "no_encoder": [57, 58]}
ALWAYS_KNOWN = ["frame", "t_s", "status", "leds_seen", *(f"q{j}_encoder_deg" for j in range(1, 7))]


def cause(
    joint: int | None, kind: str, value: float, expanded: float | None, unit: str
) -> dict[str, Any]:
    u = None if expanded is None else expanded / 2
    return {"joint": joint, "kind": kind, "value": value, "unit": unit, "standard_uncertainty": u,
            "expanded_uncertainty": expanded, "explains": 0.97}  # fmt: skip


CAUSES: list[dict[str, Any]] = [
    cause(2, "offset", 0.4, 0.015, "deg"),
    cause(2, "gain", 0.0052, 0.0004, "ratio"),
    cause(4, "backlash", 0.31, 0.04, "deg"),
    cause(5, "eccentricity", 0.12, 0.02, "deg") | {"phase_deg": 41.3, "per_turn": 1},
    cause(None, "clock", -0.0123, 0.0006, "s"),
    cause(2, "dh", 0.84, 0.2, "mm") | {"parameter": "a2"},
    cause(4, "compliance", 0.52, 0.05, "deg/m"),
    cause(5, "latency", 0.0199, 0.0004, "s"),
    cause(5, "drift", -12.0, 1.2, "deg/h"),
    cause(None, "clock_drift", 140.0, 14.0, "ppm"),
    cause(None, "camera_skew", 0.0031, 0.00031, "s"),
    cause(None, "camera_turned", 0.05, 0.005, "deg"),
    cause(None, "camera_drift", -0.06, 0.005, "deg"),
    cause(None, "camera_tilted", 0.057, 0.002, "deg"),
    cause(None, "base_moved", 1.2, 0.12, "mm") | {"turn_deg": 0.081},
    cause(None, "base_drift", 0.9, 0.09, "mm") | {"turn_deg": 0.064},
    cause(None, "led_body_slipped", 0.4, 0.04, "mm") | {"turn_deg": 0.12},
    dict.fromkeys(cause(None, "", 0, 0, "")) | {"kind": "geometry", "explains": 0.4},
    cause(4, "step", 0.8, 0.08, "deg") | {"t_s": 7.04},
    cause(1, "novel_kind", 0.5, 0.1, "furlong"),
    {"joint": None, "kind": "ambiguous", "explains": 0.2,
     "candidates": ["something said in words", cause(6, "offset", 0.1, None, "deg")]},
]  # fmt: skip
UNCLEAR: list[dict[str, Any]] = [
    {"joint": None, "kind": "ambiguous", "explains": 0.31,
     "candidates": [cause(3, "offset", 0.05, 0.06, "deg"), cause(4, "offset", -0.05, 0.06, "deg")]}
]  # fmt: skip


@cache
def nonconforming(joints: int = 6, pairs: int = PAIRS) -> Results:
    """Joint 2 reads 0.349° too high; a few pairs were not measured. One joint more, or fewer."""
    results = sample_results(FAULTY)
    tables = {name: _of_joints(table, joints) for name, table in results.tables.items()}
    for name in ("frames", "spots", "resolved"):
        tables[name] = _of_pairs(tables[name], pairs)
    rejected = {k: [f for f in frames if f < pairs] for k, frames in LOST.items()}
    for status, frames in rejected.items():
        rows = tables["frames"]["frame"].isin(frames)
        tables["frames"].loc[rows, "status"] = status
        tables["frames"].loc[rows, tables["frames"].columns.difference(ALWAYS_KNOWN)] = np.nan
        for name in ("spots", "resolved"):
            tables[name] = tables[name][~tables[name]["frame"].isin(frames)].reset_index(drop=True)
    counts = {status: len(frames) for status, frames in rejected.items() if frames}
    old, numbers = results.summary, range(joints)
    budgets = [old["budget"]["joints"][min(i, 5)] | {"joint": i + 1} for i in numbers]
    summary = old | {
        "pairs": {"recorded": pairs, "measured": pairs - sum(counts.values()), "rejected": counts},
        "joints": [old["joints"][min(i, 5)] | {"joint": i + 1} for i in numbers],
        "joint_error_correlation": np.eye(joints).tolist(),
        "budget": old["budget"] | {"joints": budgets},
        "combinations": [c for c in old["combinations"] if max(c["joints"]) <= joints],
    }
    arm = results.setup["robot"]
    rows = [arm["joints"][min(i, 5)] | {"joint": i + 1, "name": f"q{i + 1}"} for i in numbers]
    setup = results.setup | {"robot": arm | {"joints": rows}}
    return Results(summary, setup, tables, results.images)


def _of_joints(table: pd.DataFrame, joints: int) -> pd.DataFrame:
    """Leave the joints beyond the last one out, or have a seventh that does as the sixth."""
    if "joint" in table:
        table = table[~(table["joint"] > joints)]
    beyond = [name for name in table if name[:1] == "q" and name[1:2] > str(joints)]
    if joints > 6:
        seventh = table.filter(regex="^q6_").rename(columns=lambda name: f"q7{name[2:]}")
        table = pd.concat([table, seventh], axis=1)
    return table.drop(columns=beyond)


def _of_pairs(table: pd.DataFrame, pairs: int) -> pd.DataFrame:
    """The session cut short, or over and over."""
    parts = [
        table.assign(frame=table["frame"] + first, t_s=table["t_s"] + first * PERIOD)
        for first in range(0, pairs, PAIRS)
    ]
    many = pd.concat(parts, ignore_index=True)
    return many[many["frame"] < pairs].reset_index(drop=True)


def conforming() -> Results:
    """A healthy arm."""
    return sample_results(SOUND)


def no_tolerance() -> Results:
    """A healthy arm, and nothing to judge it by."""
    unjudged = dict.fromkeys(("verdict", "tolerance_deg", "conformance_probability"))
    unjudged["reason"] = "no_tolerance"
    results = conforming()
    rows = [row | unjudged for row in results.summary["joints"]]
    return replace(results, summary=results.summary | {"verdict": None, "joints": rows})


def undecided() -> Results:
    """An instrument that is too poor for the tolerance, and two joints that cannot be seen."""
    results = conforming()
    summary = dict(results.summary)
    rows = [dict(row) for row in summary["joints"]]
    for row in rows:
        row |= {"verdict": "undecided", "reason": "uncertainty_too_large"}
        row |= {"visible_fraction": 0.05, "conformance_probability": 0.62}
    for row in (rows[0], rows[5]):
        row |= {"reason": "not_observable", "visible_fraction": 0.0, "mean_error_deg": None}
        row |= {"minimum_detectable_error_deg": None, "minimum_separable_error_deg": None}
    rows[3]["reason"] = "not_detectable"
    rows[4]["reason"] = "lack_of_fit"
    summary |= {
        "joints": rows,
        "verdict": "undecided",
        "diagnosis": UNCLEAR,
        "budget": {"uncounted": ["rig", "robot base"]},
        "warnings": [
            "rig.toml: no [covariance]; the rig is taken as exact.",
            "Base and LEDs were fitted through the same encoders: frames.csv holds residuals.",
        ],
        "clock": {"encoder_offset_s": None, "standard_uncertainty_s": None, "source": None,
                  "observable": False},
    }  # fmt: skip
    tables = {name: table for name, table in results.tables.items() if name != "clock_curve"}
    return replace(results, summary=summary, tables=tables, images={})


def every_cause() -> Results:
    """One cause of each kind."""
    results = nonconforming()
    return replace(results, summary=results.summary | {"diagnosis": CAUSES})


def nulls() -> Results:
    """Whatever may be unknown is unknown."""
    results = nonconforming()
    summary = {k: _nulled(v, {"joint"}) for k, v in results.summary.items()}
    summary["diagnosis"] = [_nulled(d, {"joint", "kind"}) for d in results.summary["diagnosis"]]
    setup = {k: _nulled(v, {"joint"}) for k, v in results.setup.items()}
    frames = results.tables["frames"].copy()
    frames[frames.columns.difference(["frame", "t_s", "status"])] = np.nan
    tables = {"frames": frames, "spots": results.tables["spots"].iloc[:0]}
    return Results(summary, setup, tables, {})


def seven_joints() -> Results:
    """An arm from a URDF with one joint more than six."""
    results = nonconforming(joints=7)
    robot = dict(results.setup["robot"])
    robot["joints"] = [
        row | dict.fromkeys(("a_mm", "d_mm", "alpha_deg")) | {"name": f"panda_joint{row['joint']}"}
        for row in robot["joints"]
    ]
    return replace(results, setup=results.setup | {"robot": robot})


def one_pair() -> Results:
    """A single stereo pair."""
    results = nonconforming(pairs=1)
    return replace(results, summary=results.summary | {"verdict": None})


def visits() -> Results:
    """Single visits far apart in time, with no motion between them that was seen."""
    results = nonconforming(pairs=24)
    frames = results.tables["frames"].copy()
    t = np.repeat(np.arange(12) * 60.0, 2) + np.tile([0.0, 0.4], 12) + 1.763e9
    frames["t_s"] = t
    resolved = results.tables["resolved"].copy()
    resolved["t_s"] = t[resolved["frame"].to_numpy()]
    return replace(results, tables=results.tables | {"frames": frames, "resolved": resolved})


HOSTILE = (
    "<script>alert(1)</script>\"'&#]$x^2$ \\ {{ 7*7 }} \n\r\x1b[31m\u202e\u2028 \udc80 *a* _b_ "
    "漢字 سلام"
)


def hostile() -> Results:
    """Every text that a user may choose is an attack on one format or the other."""
    results = nonconforming()
    summary = _poisoned(results.summary, {"verdict", "reason", "status", "kind", "source", "why"})
    setup = _poisoned(results.setup, set())
    tables = dict(results.tables)
    spots, budget = tables["spots"].copy(), tables["budget"].copy()
    safe = HOSTILE.replace("\udc80", "")  # Parquet holds no half characters
    spots["led"] = safe + spots["led"]
    budget["source"] = safe * 3 + budget["source"]
    return Results(summary, setup, tables | {"spots": spots, "budget": budget}, results.images)


nothing = partial(Results, {}, {}, {}, {})  # not even the keys are there
EVERY: dict[str, Callable[[], Results]] = {
    "nonconforming": nonconforming, "conforming": conforming, "no_tolerance": no_tolerance,
    "undecided": undecided, "every_cause": every_cause, "nulls": nulls, "nothing": nothing,
    "seven_joints": seven_joints, "one_joint": partial(nonconforming, joints=1, pairs=20),
    "one_pair": one_pair, "visits": visits, "hostile": hostile,
}  # fmt: skip


def _changed(value: Any, kept: set[str], change: Callable[[Any], Any]) -> Any:
    """Change every value, however deep, but those of kept keys."""
    if isinstance(value, dict):
        return {k: v if k in kept else _changed(v, kept, change) for k, v in value.items()}
    if isinstance(value, list):
        return [_changed(v, kept, change) for v in value]
    return change(value)


_nulled = partial(_changed, change=lambda _: None)
_poisoned = partial(_changed, change=lambda v: HOSTILE + v if isinstance(v, str) else v)
