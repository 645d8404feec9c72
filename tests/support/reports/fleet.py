"""Fleet results made by hand: two arms with six joints, a dot a session on plain curves."""

from datetime import UTC, date, datetime
from typing import Any

import numpy as np
import pandas as pd

from reports.results import Results

SESSIONS = 60
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def day(year: int, month: int, number: int) -> float:
    """Days since 1970."""
    return (datetime(year, month, number, tzinfo=UTC) - EPOCH).total_seconds() / 86_400


def changed(since: date | None = None, arm: str = "arm_a") -> Results:
    """Joint 3 of one arm drifts up, joint 5 of the other stepped down."""
    results = _results((arm, "arm_b"))
    table = results.tables["joints"]
    drifts = (table["arm"] == arm) & (table["joint"] == 3)
    steps = (table["arm"] == "arm_b") & (table["joint"] == 5)
    table.loc[drifts, "state"] = "drift"
    table.loc[drifts, ["trend_deg_per_month", "trend_u_deg_per_month"]] = [0.02, 0.002]
    table.loc[drifts, "worse"] = True
    table.loc[steps, "state"] = "step"
    first, last = day(2025, 1, 2), day(2025, 6, 14)
    results.tables["changes"] = pd.DataFrame(
        [
            _change(arm, 3, "drift", first, first, 0.02, 0.002, "000"),
            _change("arm_b", 5, "step", last, day(2025, 6, 10), -0.3, 0.01, "040"),
        ]
    )
    if since is not None:
        results.summary["since"] = since.isoformat()
        results.tables["contrasts"] = pd.DataFrame([_contrast(since)])
    results.tables["worst"].loc[0, "reported"] = True
    return results


def quiet() -> Results:
    """Nothing changed."""
    return _results(("arm_a", "arm_b"))


def young() -> Results:
    """Too few sessions to follow anything."""
    results = _results(("arm_a",))
    table = results.tables["joints"].drop(columns=["error_deg", "error_u_deg", "worse"])
    results.tables["joints"] = table.assign(state="unknown", sessions=2)
    results.tables["points"] = results.tables["points"].iloc[:0]
    return results


def _results(arms: tuple[str, ...]) -> Results:
    joints = [_joint(arm, j) for arm in arms for j in range(1, 7)]
    points = pd.concat([_points(arm, j) for arm in arms for j in range(1, 7)], ignore_index=True)
    worst = pd.DataFrame(
        [
            {"session": "lab/arm_b/040", "arm": "arm_b", "started": "2025-06-14", "joint": 5,
             "worst_error_deg": -0.31, "worst_error_u_deg": 0.02, "verdict": "nonconform",
             "kept_in": "sessions/040", "reported": False}
        ]
    )  # fmt: skip
    failures = pd.DataFrame(
        [{"session": 'lab/bad,"x"\ny', "kind": "refused", "why": "lab/bad: has no frames.csv."}]
    )
    summary: dict[str, Any] = {
        "kind": "fleet",
        "format": 1,
        "tool": {"name": "verify", "version": "1.0"},
        "sessions": {"measured": len(arms) * SESSIONS, "failed": 1, "undated": 0,
                     "first": "2025-01-02", "last": "2025-12-30", "pairs_recorded": 7200,
                     "pairs_measured": 7150},
        "verdicts": {"conform": 110, "nonconform": 10},
        "arms": list(arms),
        "false_alarm": 0.01,
        "fewest_sessions": 6,
        "by": "robot",
        "since": None,
        "compare": None,
    }  # fmt: skip
    tables = {
        "joints": pd.DataFrame(joints),
        "changes": pd.DataFrame([_change("", 0, "step", 0, 0, 0, 0, "")]).iloc[:0],
        "points": points,
        "contrasts": pd.DataFrame(),
        "worst": worst,
        "failures": failures,
    }
    return Results(summary, {}, tables)


def _joint(arm: str, joint: int) -> dict[str, Any]:
    return {
        "arm": arm, "joint": joint, "sessions": SESSIONS, "without_figure": 0, "undated": 0,
        "state": "steady", "conform": 55, "nonconform": 5, "undecided": 0, "detectable_deg": 0.05,
        "separable_deg": 0.2, "visible": 1.0, "visible_since": 1.0, "error_deg": 0.01 * joint,
        "error_u_deg": 0.02, "trend_deg_per_month": 0.0, "trend_u_deg_per_month": 0.0,
        "worse": False, "odd_sessions": 0, "excess": 1.0,
    }  # fmt: skip


def _points(arm: str, joint: int) -> pd.DataFrame:
    t = np.linspace(day(2025, 1, 2), day(2025, 12, 30), SESSIONS)
    level = np.full(SESSIONS, 0.01 * joint)
    return pd.DataFrame(
        {
            "arm": arm,
            "joint": joint,
            "session": [f"lab/{arm}/{i:03d}" for i in range(SESSIONS)],
            "t_days": t,
            "error_deg": level + 0.02 * np.sin(7.0 * t),
            "u_deg": 0.02,
            "fitted_deg": level,
            "reference_deg": level,
            "low_deg": level - 0.1,
            "high_deg": level + 0.1,
            "odd": np.arange(SESSIONS) == 5 * joint,
            "calibration": (np.arange(SESSIONS) > 30).astype(int),
        }
    )


def _change(
    arm: str, joint: int, kind: str, at: float, before: float, size: float, u: float, session: str
) -> dict[str, Any]:
    return {
        "arm": arm, "joint": joint, "kind": kind, "term": kind,
        "session": f"lab/{arm}/{session}", "t_days": at, "before_t_days": before,
        "earliest_t_days": at, "latest_t_days": at + 10, "size": size, "size_u": u,
        "unit": "deg" if kind == "step" else "deg/month", "clearer_by": 42.0,
        "recalibrated": False,
    }  # fmt: skip


def _contrast(since: date) -> dict[str, Any]:
    return {
        "question": "since", "arm": "arm_b", "joint": 5, "first": f"before {since}",
        "second": f"since {since}", "first_sessions": 28, "second_sessions": 32,
        "first_deg": 0.05, "second_deg": -0.25, "difference_deg": -0.3,
        "difference_u_deg": 0.01, "shown": True,
    }  # fmt: skip
