"""A plan as facts and as a table, in the units of pages: what is shown before anything moves."""

from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

import robots
from verify.grasping.planning.object import GraspRefusal
from verify.grasping.planning.plan import GraspPlan, GraspPlanner

_MM = 1e3  # of a metre


def plan_facts(found: GraspPlan | GraspRefusal) -> dict[str, Any]:
    """Tell a plan, or why there is none, as what JSON can hold; millimetres, degrees, seconds."""
    if isinstance(found, GraspRefusal):
        return {
            "refused": found.kind,
            "reason": found.reason,
            "branches": dict(found.branches),
        }
    posture, margin = found.posture, found.margin
    return {
        "posture": posture.name,
        "score": round(posture.score, 4),
        "scores": {
            key: round(getattr(posture, key), 4)
            for key in ("limits", "dexterity", "nearness", "clearance")
        },
        "above_deg": _rounded(np.degrees(posture.q_above)),
        "grip_deg": _rounded(np.degrees(posture.q_grip)),
        "grip_mm": _rounded(margin.grip * _MM),
        "raised_mm": round(margin.raised * _MM, 3),
        "margin_across_mm": round(margin.across * _MM, 3),
        "needed_across_mm": round(margin.across_needed * _MM, 3),
        "margin_along_mm": round(margin.along * _MM, 3),
        "needed_along_mm": round(margin.along_needed * _MM, 3),
        "over_s": [round(part.duration, 3) for part in found.over],
        "down_s": round(found.down.duration, 3),
        "up_s": round(found.up.duration, 3),
        "slowed": round(found.slowed, 3),
        "not_taken": found.rejected,
    }


def motion_table(setup: GraspPlanner, found: GraspPlan, period: float) -> pd.DataFrame:
    """Lay a plan out in time, one row a period, for a figure.

    Args:
        setup: arm and cell.
        found: the plan.
        period: s, from row to row.

    Returns:
        Columns part (over, down, up), t_s, q1_deg…qN_deg, x_mm, y_mm, z_mm (the grip point in the
        base) and clearance_mm (the least of all, of table, cameras and box).
    """
    parts = [*(("over", part) for part in found.over), ("down", found.down), ("up", found.up)]
    starts = np.cumsum([0.0, *(part.duration for _, part in parts)])
    tables = []
    for (name, part), (start, _) in zip(parts, pairwise(starts.tolist()), strict=True):
        times, motion = part.sampled(period)
        grip = robots.forward(setup.arm, motion.q) @ setup.cell.gripper.flange_T_grip
        degrees = np.degrees(motion.q)
        columns: dict[str, Any] = {"part": name, "t_s": start + times}
        columns |= {f"q{joint + 1}_deg": degrees[:, joint] for joint in range(setup.arm.dof)}
        columns |= {f"{axis}_mm": grip[:, i, 3] * _MM for i, axis in enumerate("xyz")}
        columns["clearance_mm"] = setup.workspace.margins(motion.q).min(axis=1) * _MM
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 3) for value in values]
