"""Results of a grasp, whole, without arm or cameras. Do not change them."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pandas as pd

from reports.results import Results
from verify.grasping.control.states import TRANSITIONS, GraspEvent, GraspState
from verify.grasping.planning.postures import branch_name

SUMMARY: dict[str, Any] = {
    "kind": "grab", "tool": {"name": "verify", "version": "0.1"}, "robot": "rv_3sd_melfa",
    "cell": "simulated", "target": "blue object", "execute": True, "state": "lifted",
    "reason": "the object came along", "released": True, "cycles": 40, "seen_from_grip_mm": 1.2,
    "seen_from_grip_expanded_uncertainty_mm": 5.4, "seen_raised_mm": 118.2, "film": "grab.mp4",
    "session": "session", "warnings": [],
}  # fmt: skip
MARGIN = {
    "across_mm": 40.0, "across_needed_mm": 3.0, "along_mm": 12.0, "along_needed_mm": 2.0,
    "raised_mm": 6.0,
}  # fmt: skip
PLACE = [440.0, 1.0, 120.0]
HAND = {
    "used": True, "reason": "the LEDs show the hand 0.52 mm ± 0.21 mm (k = 2) off",
    "pictures": 12, "measured": 8, "told_mm": PLACE, "read_mm": PLACE, "seen_mm": PLACE,
    "off_mm": [0.1, 0.2, 0.3], "off_expanded_uncertainty_mm": [0.2, 0.2, 0.3],
}  # fmt: skip
PLAN = {
    "branch": branch_name(0), "score": 0.41, "duration_s": 6.2, "margin": MARGIN,
    "parts": {"limits": 0.8, "dexterity": 0.7, "nearness": 0.9, "clearance": 0.8},
    "rejected": [{"branch": branch_name(4), "reason": "next to a singularity (wrist)"}],
}  # fmt: skip


def grabbed(changes: dict[str, Any]) -> Results:
    """A whole grab with other words in its summary: planned, the hand measured, lifted."""
    tables = {"cycles": _cycles(), "plan": _planned(), "passages": _every_passage()}
    return Results(SUMMARY | {"plan": PLAN, "hand": HAND} | changes, {}, tables, {})


def filmed() -> Results:
    """The same with pictures of a film's shape, and a film that the page holds."""
    picture = np.zeros((780, 1280, 3), np.uint8) + np.uint8([60, 90, 60])
    picture[200:300, 300:420] = picture[200:300, 900:1020] = [200, 60, 40]  # BGR: the object
    images = {"pictures": cv2.imencode(".png", picture)[1].tobytes()}
    return replace(grabbed({}), images=images, films={"grab.mp4": b"\0" * 300_000})


def _cycles() -> pd.DataFrame:
    """Cycles through every state."""
    count = SUMMARY["cycles"]
    t, states = np.linspace(0.0, 8.0, count), [state.value for state in GraspState]
    columns: dict[str, Any] = {"t_s": t, "quality": 0.8, "took_ms": 5.0}
    columns["state"] = [states[i * len(states) // count] for i in range(count)]
    for k, axis in enumerate("xyz"):
        columns |= {f"target_{axis}_mm": 400.0 + k + t, f"grip_{axis}_mm": 420.0 + k - t}
        columns[f"u_{axis}_mm"] = 0.4 + 0.01 * t
    for side in ("left", "right"):
        columns |= {f"{side}_{name}_px": 30 + t for name in ("x", "y", "width", "height")}
    for joint in range(1, 7):
        columns |= {f"q{joint}_deg": joint * t, f"q{joint}_ordered_deg": joint * t + 0.1}
    return pd.DataFrame(columns)


def _planned() -> pd.DataFrame:
    """A plan of three parts."""
    t = np.linspace(0.0, 3.0, 30)
    columns: dict[str, Any] = {"t_s": t, "part": np.repeat(["over", "down", "up"], 10)}
    columns |= {f"q{joint}_deg": joint * t for joint in range(1, 7)}
    return pd.DataFrame(columns | {f"grip_{axis}_mm": 400 + t for axis in "xyz"})


def _every_passage() -> pd.DataFrame:
    """Every transition of the table, and every event."""
    rows = [[0.0, w.source.value, w.event.value, w.target.value, w.because] for w in TRANSITIONS]
    rows += [[1.0, "idle", event.value, "idle", "started"] for event in GraspEvent]
    return pd.DataFrame(rows, columns=["t_s", "from_state", "event", "to_state", "reason"])
