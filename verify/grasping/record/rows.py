"""Write a grasp as tables: cycles, state changes, plan, hand offset; units in the column names."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from verify.core.records import Array
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.states import StateChange
from verify.grasping.planning.object import GraspRefusal
from verify.grasping.planning.plan import GraspPlan
from verify.grasping.planning.postures import branch_name
from verify.grasping.planning.workspace import Workspace
from verify.grasping.tool_offset.offset import OffsetMeasurement
from verify.grasping.tracking.camshift import Blob

_MM = 1e3  # mm/m
PLAN_PERIOD = 0.02  # s between two rows of a plan


def cycle_row(cycle: LoopCycle, workspace: Workspace) -> dict[str, Any]:
    """Write a cycle as one row."""
    row: dict[str, Any] = {"t_s": cycle.t, "state": cycle.state.value}
    observation, target = cycle.observation, cycle.target
    row["status"] = None if observation is None else observation.status
    row["lost_because"] = None if observation is None else observation.reason
    row["quality"] = None if observation is None else observation.quality
    if target is not None:
        row |= _point("target", target.thing.position)
        spread = np.sqrt(np.diag(target.thing.covariance))
        row |= {f"u_{axis}_mm": _MM * u for axis, u in zip("xyz", spread, strict=True)}
        row["width_mm"] = _MM * target.thing.width
    for side in ("left", "right"):
        outline: Blob | None = None if observation is None else getattr(observation, side)
        values = (None,) * 4 if outline is None else (*outline.centre.tolist(), *outline.box[2:])
        whats = (f"{side}_{what}_px" for what in ("x", "y", "width", "height"))
        row |= dict(zip(whats, values, strict=True))
    if cycle.q is not None:
        row |= _joints("q{}_deg", cycle.q)
        row |= _point("grip", workspace.grip(cycle.q)[:3, 3])
    if cycle.q_ordered is not None:
        row |= _joints("q{}_ordered_deg", cycle.q_ordered)
    if cycle.gripper is not None:
        opening = cycle.gripper.opening
        row["gripper"] = cycle.gripper.state.value
        row["opening_mm"] = None if opening is None else _MM * opening
    row["took_ms"] = 1e3 * cycle.took
    return row


def state_changes_table(passages: Sequence[StateChange]) -> pd.DataFrame:
    """Write the states' passages, one a row."""
    rows = [(p.t, p.source.value, p.event.value, p.target.value, p.reason) for p in passages]
    return pd.DataFrame(rows, columns=["t_s", "from_state", "event", "to_state", "reason"])


def plan_table(plan: GraspPlan | None, workspace: Workspace) -> pd.DataFrame:
    """Write a plan's joint angles and grip point over time; empty where there is no plan."""
    if plan is None:
        return pd.DataFrame()
    rows: list[dict[str, Any]] = []
    began = 0.0
    for part, way in (*(("over", way) for way in plan.over), ("down", plan.down), ("up", plan.up)):
        times, motion = way.sampled(PLAN_PERIOD)
        grips = workspace.grip(motion.q)[:, :3, 3]
        for t, q, grip in zip(times, motion.q, grips, strict=True):
            row: dict[str, Any] = {"t_s": began + float(t), "part": part}
            rows.append(row | _joints("q{}_deg", q) | _point("grip", grip))
        began += way.duration
    return pd.DataFrame(rows)


def tool_offset_table(measurement: OffsetMeasurement | None, workspace: Workspace) -> pd.DataFrame:
    """Write the pictures in which the hand was measured, one a row; its grip point by its LEDs."""
    rows: list[dict[str, Any]] = []
    for sight in measurement.sights if measurement is not None else ():
        row: dict[str, Any] = {"t_s": sight.t, "status": sight.status}
        if sight.base_T_flange is not None:
            row |= _point("grip", _grip_position(sight.base_T_flange, workspace))
        rows.append(row)
    return pd.DataFrame(rows, columns=["t_s", "status", "grip_x_mm", "grip_y_mm", "grip_z_mm"])


def tool_offset_fields(measurement: OffsetMeasurement, workspace: Workspace) -> dict[str, Any]:
    """Write where the hand was ordered, read and measured, and the offset; mm, k = 2."""
    hand = measurement.hand
    places = {"told": measurement.ordered, "read": measurement.read, "seen": measurement.measured}
    off, spread = (None, None) if hand is None else (hand.off, np.sqrt(np.diag(hand.covariance)))
    return {
        "used": measurement.used,
        "reason": measurement.reason,
        "pictures": len(measurement.sights),
        "measured": sum(sight.base_T_flange is not None for sight in measurement.sights),
        **{
            f"{what}_mm": None if pose is None else (_MM * _grip_position(pose, workspace)).tolist()
            for what, pose in places.items()
        },
        "off_mm": None if off is None else (_MM * off).tolist(),
        "off_expanded_uncertainty_mm": None if spread is None else (2 * _MM * spread).tolist(),
    }


def plan_fields(plan: GraspPlan | GraspRefusal) -> dict[str, Any]:
    """Write a plan, or why there is none, as JSON can hold it; mm, degrees, s."""
    rejected = plan.branches if isinstance(plan, GraspRefusal) else plan.rejected.items()
    reasons = [{"branch": name, "reason": reason} for name, reason in rejected]
    if isinstance(plan, GraspRefusal):
        return {"kind": plan.kind, "reason": plan.reason, "rejected": reasons}
    posture, margin = plan.posture, plan.margin
    parts = ("limits", "dexterity", "nearness", "clearance")
    lengths = ("across", "across_needed", "along", "along_needed", "raised")
    return {
        "branch": branch_name(posture.branch),
        "score": posture.score,
        "parts": {part: getattr(posture, part) for part in parts},
        "q_above_deg": np.degrees(posture.q_above).tolist(),
        "q_grip_deg": np.degrees(posture.q_grip).tolist(),
        "grip_mm": (_MM * margin.grip).tolist(),
        "margin": {f"{name}_mm": _MM * getattr(margin, name) for name in lengths},
        "slowed": plan.slowed,
        "duration_s": sum(w.duration for w in (*plan.over, plan.down, plan.up)),
        "up_s": plan.up.duration,
        "rejected": reasons,
    }


def _grip_position(base_T_flange: Array, workspace: Workspace) -> Array:
    """Where the grip point is, (3,), m."""
    return (base_T_flange @ workspace.cell.gripper.flange_T_grip)[:3, 3]


def _point(name: str, point: Array) -> dict[str, float]:
    return {f"{name}_{axis}_mm": float(_MM * v) for axis, v in zip("xyz", point, strict=True)}


def _joints(pattern: str, q: Array) -> dict[str, float]:
    return {pattern.format(n): float(v) for n, v in enumerate(np.degrees(q), start=1)}
