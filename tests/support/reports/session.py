"""Results made by hand, from a small recipe of sines and noise: nothing here measures anything."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import cv2
import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from reports.results import Results

LEDS = ("A", "B", "C", "D")
REJECTED = ("too_few_leds", "ambiguous_leds", "no_encoder", "unreachable", "outlier", "unaligned")
SOURCES = (
    ("spot noise", "random", 0.30),
    ("encoder resolution", "random", 0.10),
    ("relative yaw of the cameras", "systematic", 0.75),
    ("robot base", "systematic", 0.45),
    ("LED positions", "systematic", 0.30),
    ("clock offset", "systematic", 0.12),
)


def nonconforming(joints: int = 6, pairs: int = 90) -> Results:
    """Joint 3 reads 0.400° too high; a few pairs were not measured."""
    return _made(joints, pairs, ((min(3, joints), 0.400),), tolerance=0.2)


def conforming() -> Results:
    """A healthy arm, a generous tolerance."""
    return _made(6, 60, (), tolerance=0.5)


def no_tolerance() -> Results:
    """A healthy arm, and nothing to judge it by."""
    return _made(6, 60, (), tolerance=None)


def undecided() -> Results:
    """An instrument that is too poor for the tolerance, and two joints that cannot be seen."""
    results = _made(6, 90, (), tolerance=0.02)
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
    rivals = [
        {"joint": j, "kind": "offset", "value": v, "unit": "deg", "expanded_uncertainty": 0.06}
        for j, v in ((3, 0.05), (4, -0.05))
    ]
    unclear = {"joint": None, "kind": "ambiguous", "candidates": rivals, "explains": 0.31}
    summary |= {
        "joints": rows,
        "verdict": "undecided",
        "diagnosis": [unclear],
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
    causes: list[dict[str, Any]] = [
        *results.summary["diagnosis"],
        cause(2, "gain", 0.0052, 0.0004, "ratio"),
        cause(4, "backlash", 0.31, 0.04, "deg"),
        cause(5, "eccentricity", 0.12, 0.02, "deg") | {"phase_deg": 41.3, "per_turn": 1},
        cause(None, "clock", -0.0123, 0.0006, "s"),
        cause(2, "dh", 0.84, 0.2, "mm") | {"parameter": "a2"},
        cause(4, "compliance", 0.52, 0.05, "deg/m"),
        cause(5, "drift", -12.0, 1.2, "deg/h"),
        cause(None, "clock_drift", 140.0, 14.0, "ppm"),
        cause(None, "camera_skew", 0.0031, 0.00031, "s"),
        cause(None, "camera_turned", 0.05, 0.005, "deg"),
        cause(None, "base_moved", 1.2, 0.12, "mm") | {"turn_deg": 0.081},
        cause(None, "led_body_slipped", 0.4, 0.04, "mm") | {"turn_deg": 0.12},
        dict.fromkeys(cause(None, "", 0, 0, "")) | {"kind": "geometry", "explains": 0.4},
        cause(4, "step", 0.8, 0.08, "deg") | {"t_s": 7.04},
        cause(1, "novel_kind", 0.5, 0.1, "furlong"),
        {"joint": None, "kind": "ambiguous", "explains": 0.2,
         "candidates": ["something said in words", cause(6, "offset", 0.1, None, "deg")]},
    ]  # fmt: skip
    return replace(results, summary=results.summary | {"diagnosis": causes})


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


@cache
def _made(
    joints: int, pairs: int, guilty: tuple[tuple[int, float], ...], tolerance: float | None
) -> Results:
    faults = dict(guilty)
    random = np.random.default_rng(20261120)
    frame = np.arange(pairs)
    t = 0.1 * frame
    status = np.full(pairs, "measured", dtype=object)
    if pairs >= 20:
        status[pairs // 3 : pairs // 3 + max(3, pairs // 40)] = "too_few_leds"
        status[random.choice(pairs, pairs // 30, replace=False)] = "outlier"
        status[-2:] = "no_encoder"
    seen = status == "measured"
    frames = pd.DataFrame({"frame": frame, "t_s": t, "status": status})
    frames["leds_seen"] = np.where(status == "too_few_leds", 2, 4)
    frames["known_dof"] = np.where(seen, 6, 0)
    frames["reprojection_rms_px"] = _known(0.05 * (1 + 0.2 * random.standard_normal(pairs)), seen)
    resolved = pd.DataFrame({"t_s": t[seen], "frame": frame[seen]})
    _add_pose(frames, t, seen, random)
    rows = []
    for joint in range(1, joints + 1):
        u = 0.02 + 0.03 * (joint in (3, 4)) + 0.02 * np.sin(0.5 * t + joint) ** 2
        scatter = u * random.standard_normal(pairs)
        offset = faults.get(joint, 0.004 * (-1) ** joint)
        truth = 30 * np.sin(0.25 * t + joint) + 10 * joint
        error = _known(offset + scatter, seen)
        frames[f"q{joint}_measured_deg"] = _known(truth, seen)
        frames[f"q{joint}_encoder_deg"] = truth + error
        frames[f"q{joint}_error_deg"] = error
        frames[f"q{joint}_u_deg"] = _known(u, seen)
        frames[f"q{joint}_error_u_deg"] = _known(1.2 * u, seen)
        fit = offset + 0.01 * np.sin(np.radians(truth))
        resolved[f"q{joint}_resolved_deg"] = fit[seen]
        resolved[f"q{joint}_resolved_u_deg"] = 0.0075 * (1 + 0.2 * np.cos(t[seen]))
        rows.append(_joint(joint, error, fit[seen], 0.0075, tolerance))
    for name, unit, size in (("position", "mm", 1.4), ("orientation", "deg", 0.33)):
        wave = size * (1 + 0.2 * np.sin(0.2 * t))
        frames[f"{name}_error_{unit}"] = _known(wave + 0.1 * random.standard_normal(pairs), seen)
        resolved[f"{name}_resolved_{unit}"] = wave[seen]
        resolved[f"{name}_resolved_u_{unit}"] = 0.05 * size
    frames["ambiguous_joints"] = ""
    offset = np.linspace(-0.5, 0.5, 201)
    curve = {"offset_s": offset, "cost": 3 + 40 * np.tanh(6 * (offset - 0.137)) ** 2}
    motions = {"turn_deg": random.uniform(15, 80, 12), "turn_u_deg": 0.02, "advance_u_mm": 0.08}
    motions |= {"turn_error_deg": random.normal(0, 0.04, 12)}
    motions |= {"advance_error_mm": random.normal(0, 0.15, 12)}
    tables = {
        "frames": frames,
        "resolved": resolved,
        "spots": _spots(t, seen, random),
        "clock_curve": pd.DataFrame(curve),
        "relative": pd.DataFrame(motions),
        "budget": _budget(rows),
    }
    picture = bytes(cv2.imencode(".png", np.full((180, 640), 18, np.uint8))[1])
    summary = _summary(frames, rows, faults, tolerance)
    return Results(summary, _setup(joints), tables, {"pair": picture})


def _known(values: np.ndarray, seen: np.ndarray) -> np.ndarray:
    return np.where(seen, values, np.nan)


def _add_pose(
    frames: pd.DataFrame, t: np.ndarray, seen: np.ndarray, random: np.random.Generator
) -> None:
    angle = np.pi / 2 * t / max(float(t[-1]), 1.0)
    pose: dict[str, np.ndarray] = {
        "x_mm": 320 * np.cos(angle),
        "y_mm": 320 * np.sin(angle),
        "z_mm": 410 + 4 * np.sin(6 * angle),
    }
    for name, values in pose.items():
        frames[name] = _known(values + 0.15 * random.standard_normal(len(t)), seen)
        frames[name.replace("_mm", "_encoder_mm")] = values + 1.1
    turned = np.stack([12 * np.sin(angle), 8 * np.cos(2 * angle), np.degrees(angle) * 2 + 100], 1)
    measured, encoder = (  # no longer than half a turn
        Rotation.from_rotvec(each, degrees=True).as_rotvec(degrees=True)
        for each in (turned + 0.04 * random.standard_normal((len(t), 3)), turned + 0.3)
    )
    for i, name in enumerate(("rx", "ry", "rz")):
        frames[f"{name}_deg"] = _known(measured[:, i], seen)
        frames[f"{name}_encoder_deg"] = encoder[:, i]


def _joint(
    joint: int, error: np.ndarray, fit: np.ndarray, u: float, tolerance: float | None
) -> dict[str, Any]:
    known = error[np.isfinite(error)]
    worst = float(fit[np.argmax(np.abs(fit))]) if len(fit) else None
    verdict, reason = None, "no_tolerance"
    if tolerance is not None and worst is not None:
        fails = abs(worst) > tolerance
        verdict = "nonconform" if fails else "conform"
        reason = "exceeds_tolerance" if fails else "within_tolerance"
    return {
        "joint": joint, "pairs": len(known), "mean_error_deg": float(known.mean()),
        "rms_error_deg": float(np.sqrt(np.mean(known**2))),
        "max_abs_error_deg": float(np.abs(known).max()), "standard_uncertainty_deg": u,
        "expanded_uncertainty_deg": 2 * u, "coverage_factor": 2.0, "worst_error_deg": worst,
        "worst_error_standard_uncertainty_deg": 1.2 * u, "tolerance_deg": tolerance,
        "conformance_probability": {"conform": 0.99312, "nonconform": 0.0}.get(str(verdict)),
        "verdict": verdict, "reason": reason, "visible_fraction": 0.998 if joint != 2 else 0.41,
        "visible_fraction_since_registration": 1.0, "minimum_detectable_error_deg": 4.13 * u,
        "minimum_separable_error_deg": 16.0 * u,
    }  # fmt: skip


def cause(
    joint: int | None, kind: str, value: float, expanded: float | None, unit: str
) -> dict[str, Any]:
    u = None if expanded is None else expanded / 2
    return {"joint": joint, "kind": kind, "value": value, "unit": unit, "standard_uncertainty": u,
            "expanded_uncertainty": expanded, "explains": 0.97}  # fmt: skip


def _summary(
    frames: pd.DataFrame,
    rows: list[dict[str, Any]],
    faults: dict[int, float],
    tolerance: float | None,
) -> dict[str, Any]:
    counts = frames["status"].value_counts()
    index = np.arange(len(rows))
    verdict = None if tolerance is None else "nonconform" if faults else "conform"
    pose = {
        "rms_error_mm": 1.42, "max_error_mm": 1.93, "expanded_uncertainty_mm": 0.14,
        "tolerance_mm": 1.0, "conformance_probability": 0.0, "verdict": verdict,
    }  # fmt: skip
    return {
        "format": 1,
        "tool": {"name": "verify", "version": "0.1.0"},
        "session": {"path": "multi_joint_fault_6r", "robot": "iust_6r",
                    "description": "all joints moving, one at fault",
                    "started": "2026-11-20T10:00:00Z"},
        "pairs": {"recorded": len(frames), "measured": int(counts.get("measured", 0)),
                  "rejected": {k: int(counts[k]) for k in REJECTED if k in counts}},
        "clock": {"encoder_offset_s": 0.1370, "standard_uncertainty_s": 0.0004,
                  "source": "estimated", "observable": True},
        "verdict": verdict,
        "decision_rule": "conform: |ê| + 1.645 u ≤ tolerance at every pair (95 %)",
        "joints": rows,
        "joint_error_correlation": (-0.83 * np.eye(len(rows), k=1) - 0.83 * np.eye(len(rows), k=-1)
                                    + np.eye(len(rows)) + 0.1 * (abs(index[:, None] - index) > 1)
                                    ).tolist(),
        "position": pose,
        "orientation": {k.replace("_mm", "_deg"): v for k, v in pose.items()},
        "diagnosis": [cause(j, "offset", v, 0.015, "deg") for j, v in faults.items()],
        "relative_motions": {"motions": 12, "turn_rms_error_deg": 0.041,
                             "advance_rms_error_mm": 0.152, "p_value": 5.1e-8,
                             "detectable_offset_deg": [None, 0.101, 0.16, 0.093, 0.067, None]},
        "combinations": [
            {"label": "q4+q6", "joints": [4, 6], "mean_error_deg": 0.0123,
             "standard_uncertainty_deg": 0.0041, "pairs": 7, "why": "singularity"},
            {"label": "q2+q3+q4", "joints": [2, 3, 4], "mean_error_deg": 0.4012,
             "standard_uncertainty_deg": 0.0052, "pairs": 80, "why": "well_known"},
        ],
        "choices": {"geometry": 71, "continuity": 9, "encoders": 0},
        "known_dof": 6,
        "thresholds": {"false_alarm": 0.001, "power": 0.8, "near_singular_sine": 0.2},
        "budget": {"uncounted": []},
        "inputs": {"rig.toml": "sha256:" + "3f" * 32, "encoders.csv": "sha256:" + "a7" * 32},
        "warnings": ["frames.csv: column temperature is not known and was left alone."],
    }  # fmt: skip


def _setup(joints: int) -> dict[str, Any]:
    def camera(x: float) -> dict[str, Any]:
        return {"fx_px": 1000.12, "fy_px": 1000.34, "cx_px": 639.5, "cy_px": 359.5,
                "distortion": [0.05, -0.12, 0.0003, -0.0002, 0.01],
                "pan_center_mm": [x, 0.0, 0.0],
                "pan_min_deg": -2.5, "pan_max_deg": 12.0}  # fmt: skip

    return {
        "rig": {"image_size_px": [1280, 720], "left": camera(-60.0), "right": camera(60.0),
                "baseline_mm": 120.0, "base_source": "fixture",
                "base_position_mm": [0.0, 120.5, 650.25],
                "base_rotation_vector_deg": [90.0, 0.0, 0.1], "registration": None},
        "marker": {"leds": [{"name": n, "x_mm": 50.0 * i, "y_mm": -40.0 + 30 * i, "z_mm": 10.0 * i,
                             "colour": "white" if i else None} for i, n in enumerate(LEDS)],
                   "led_diameter_mm": 5.0, "source": "jig", "datum": "dowel hole of the flange",
                   "body_standard_uncertainty": {"x_mm": 0.05, "y_mm": 0.05, "z_mm": 0.05,
                                                 "rx_deg": 0.05, "ry_deg": 0.05, "rz_deg": 0.08},
                   "led_standard_uncertainty_mm": 0.05,
                   "centre_shift_standard_uncertainty_mm": 0.01},
        "robot": {"name": "iust_6r", "family": "parallel_axes", "source": "paper, table 1",
                  "fingerprint": "sha256:" + "c4" * 32,
                  "joints": [{"joint": j, "name": f"q{j}", "a_mm": 50.0 * j, "d_mm": 438.0 - 60 * j,
                              "alpha_deg": 90.0, "sign": 1 if j % 2 else -1, "offset_deg": 0.0,
                              "lower_deg": -170.0, "upper_deg": 170.0}
                             for j in range(1, joints + 1)]},
    }  # fmt: skip


def _spots(t: np.ndarray, seen: np.ndarray, random: np.random.Generator) -> pd.DataFrame:
    frame = np.repeat(np.flatnonzero(seen), 2 * len(LEDS))
    n = len(frame)
    residual = 0.05 * random.standard_normal((n, 2))
    used = random.random(n) > 0.02
    residual[~used] *= 6
    return pd.DataFrame({
        "frame": frame,
        "t_s": t[frame],
        "camera": np.tile(np.repeat(["left", "right"], len(LEDS)), n // (2 * len(LEDS))),
        "led": np.tile(LEDS, n // len(LEDS)),
        "x_px": 640 + 200 * random.standard_normal(n),
        "y_px": 360 + 100 * random.standard_normal(n),
        "u_px": 0.05,
        "residual_x_px": residual[:, 0],
        "residual_y_px": residual[:, 1],
        "used": used,
    })  # fmt: skip


def _budget(rows: list[dict[str, Any]]) -> pd.DataFrame:
    return pd.DataFrame(
        [(row["joint"], source, kind, share * row["standard_uncertainty_deg"])
         for row in rows for source, kind, share in SOURCES],
        columns=["joint", "source", "kind", "standard_uncertainty_deg"],
    )  # fmt: skip


def _changed(value: Any, kept: set[str], change: Callable[[Any], Any]) -> Any:
    """Change every value, however deep, but those of kept keys."""
    if isinstance(value, dict):
        return {k: v if k in kept else _changed(v, kept, change) for k, v in value.items()}
    if isinstance(value, list):
        return [_changed(v, kept, change) for v in value]
    return change(value)


_nulled = partial(_changed, change=lambda _: None)
_poisoned = partial(_changed, change=lambda v: HOSTILE + v if isinstance(v, str) else v)
