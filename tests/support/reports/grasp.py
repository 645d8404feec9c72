"""Results of grasps with every state, event and reason."""

from typing import Any

import numpy as np
import pandas as pd

from reports.results import Results
from verify.grasping.control.states import TRANSITIONS, GraspEvent, GraspState
from verify.grasping.planning.postures import branch_name

N = 40  # cycles
SUMMARY: dict[str, Any] = {
    "kind": "grab",
    "tool": {"name": "verify", "version": "0.1"},
    "robot": "rv_3sd_melfa",
    "cell": "simulated",
    "target": "blue object",
    "execute": True,
    "state": "lifted",
    "reason": "the object came along",
    "released": True,
    "cycles": N,
    "seen_from_grip_mm": 1.2,
    "seen_from_grip_expanded_uncertainty_mm": 5.4,
    "seen_raised_mm": 118.2,
    "film": "grab.mp4",
    "session": "session",
    "warnings": [],
}
MARGIN = {
    "across_mm": 40.0,
    "across_needed_mm": 3.0,
    "along_mm": 12.0,
    "along_needed_mm": 2.0,
    "raised_mm": 6.0,
}


def results(changes: dict[str, Any], passages: pd.DataFrame | None = None) -> Results:
    """Make the results of a whole grab with other words in its summary."""
    tables = {"cycles": cycles(), "plan": planned()}
    tables["passages"] = every_passage() if passages is None else passages
    return Results(SUMMARY | changes, {}, tables, {})


def whole() -> Results:
    """Make a grab that was planned, seen, refused in one branch, and lifted."""
    message = (
        "the LEDs show the hand 0.52 mm ± 0.21 mm (k = 2) off, and its end point was corrected"
    )
    near = "the forearm would come 12 mm too near to the table, after 30% of the way"
    changes = {
        "plan": plan({branch_name(3): near, branch_name(4): "next to a singularity (wrist)"}),
        "hand": hand(f"{message} for it", seen=True),
    }
    return results(changes)


def cycles() -> pd.DataFrame:
    """Cycles through every state."""
    t = np.linspace(0.0, 8.0, N)
    states = [state.value for state in GraspState]
    output: dict[str, Any] = {
        "t_s": t,
        "state": [states[i * len(states) // N] for i in range(N)],
        "quality": np.full(N, 0.8),
        "took_ms": np.full(N, 5.0),
    }
    for k, axis in enumerate("xyz"):
        output |= {f"target_{axis}_mm": 400.0 + k + t, f"grip_{axis}_mm": 420.0 + k - t}
        output[f"u_{axis}_mm"] = 0.4 + 0.01 * t
    for side in ("left", "right"):
        output |= {f"{side}_{what}_px": 30 + t for what in ("x", "y", "width", "height")}
    for joint in range(1, 7):
        output |= {f"q{joint}_deg": joint * t, f"q{joint}_ordered_deg": joint * t + 0.1}
    return pd.DataFrame(output)


def planned() -> pd.DataFrame:
    """A plan of three parts."""
    t = np.linspace(0.0, 3.0, 30)
    output: dict[str, Any] = {"t_s": t, "part": np.repeat(["over", "down", "up"], 10)}
    output |= {f"q{joint}_deg": joint * t for joint in range(1, 7)}
    return pd.DataFrame(output | {f"grip_{axis}_mm": 400 + t for axis in "xyz"})


def every_passage() -> pd.DataFrame:
    """Every transition of the table, and every event."""
    rows = [[0.0, w.source.value, w.event.value, w.target.value, w.because] for w in TRANSITIONS]
    rows += [[1.0, "idle", event.value, "idle", "started"] for event in GraspEvent]
    return pd.DataFrame(rows, columns=["t_s", "from_state", "event", "to_state", "reason"])


def plan(rejected: dict[str, str]) -> dict[str, Any]:
    """A plan, with why other branches are not taken."""
    return {
        "branch": branch_name(0),
        "score": 0.41,
        "parts": {"limits": 0.8, "dexterity": 0.7, "nearness": 0.9, "clearance": 0.8},
        "duration_s": 6.2,
        "margin": MARGIN,
        "rejected": [{"branch": name, "reason": message} for name, message in rejected.items()],
    }


def hand(reason: str, *, seen: bool) -> dict[str, Any]:
    """What was seen of the hand."""
    place = [440.0, 1.0, 120.0]
    return {
        "used": seen,
        "reason": reason,
        "pictures": 12,
        "measured": 8 * seen,
        "told_mm": place,
        "read_mm": place,
        "seen_mm": place if seen else None,
        "off_mm": [0.1, 0.2, 0.3] if seen else None,
        "off_expanded_uncertainty_mm": [0.2, 0.2, 0.3] if seen else None,
    }
