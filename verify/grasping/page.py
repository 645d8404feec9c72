"""Give the page of a grasp its content: millimetres, degrees, pixels, seconds.

The loop shows each cycle with `show`; the page's thread reads the newest. Nothing here can order
anything: no driver that moves is imported, and the loop is only read.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from robots.transforms import carry, invert
from verify.core.rig import Rig
from verify.grasping.cell import WatchdogLimits
from verify.grasping.control import states
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.loop import UNSELECTED, GraspLoop
from verify.grasping.planning.object import GraspRefusal
from verify.grasping.planning.plan import GraspPlan
from verify.grasping.planning.workspace import Workspace
from verify.grasping.record.rows import plan_fields
from verify.grasping.tracking.camshift import Blob
from verify.grasping.tracking.target import TargetObservation
from verify.live.page.run import camera_poses
from verify.live.page.scene import joint_origins, millimetres, small_jpeg
from verify.live.snapshot import MAX_TEXT_LENGTH

_MM = 1e3  # of a metre
MAX_STATE_CHANGES = 12  # shown, the newest
N_PATH_POINTS = 24  # points of a planned motion
SILENCE_TIMEOUT = 1.0  # s without a cycle of the loop, and the page says so


def device_status(
    cycle: LoopCycle, loop: GraspLoop, watch: WatchdogLimits
) -> tuple[tuple[str, bool, str], ...]:
    """List each device's name, whether it is well, and its status; the cameras come first."""
    arm, fingers = loop.arm, cycle.gripper
    lines = [
        _age_status("cameras", cycle.t, loop.pictures_t, watch.stale),
        _age_status("joints", cycle.t, loop.joints_t, watch.joints),
    ]
    if not loop.may_move:
        return (*lines, ("arm", True, "is read and not moved: --execute is not given"))
    if arm is not None:
        speed = "" if arm.speed is None else f"{_MM * arm.speed:.0f} mm/s"
        text = ", ".join(filter(None, (arm.state.value, speed, arm.reason)))
        lines.append(("arm", arm.state != "failed", text))
    if fingers is not None:
        opening = "" if fingers.opening is None else f"{_MM * fingers.opening:.0f} mm open"
        text = ", ".join(filter(None, (fingers.state.value, opening, fingers.reason)))
        lines.append(("gripper", fingers.state not in ("failed", "lost"), text))
    return tuple(lines)


def _age_status(name: str, now: float, t: float | None, limit: float) -> tuple[str, bool, str]:
    if t is None:
        return name, False, "nothing has come yet"
    old = max(now - t, 0.0)
    return name, old <= limit, f"{old:.2f} s old, limit {limit:g} s"


def target_fields(
    observation: TargetObservation | None, *, selected: bool, fresh: bool
) -> dict[str, Any]:
    """The target in the newest pictures, and the quality of its measurement."""
    if observation is None:
        because = "no pictures yet" if selected else UNSELECTED
        return {"status": None, "unseen_because": because, "quality": None}
    if not fresh:
        return {"status": "not seen", "unseen_because": "the pictures are old", "quality": None}
    return {
        "status": observation.status,
        "unseen_because": observation.reason,
        "quality": round(observation.quality, 3) if np.isfinite(observation.quality) else None,
    }


def object_fields(cycle: LoopCycle) -> dict[str, Any]:
    """The target's position in the base, with its uncertainty, and its size."""
    target = cycle.target
    fields: dict[str, Any] = {"position_mm": None}
    if target is not None and np.isfinite(target.thing.covariance).all():
        thing = target.thing
        fields["position_mm"] = np.round(_MM * thing.position, 2).tolist()
        fields["standard_uncertainty_mm"] = np.round(
            _MM * np.sqrt(np.diag(thing.covariance)), 2
        ).tolist()
        fields["size_mm"] = [_finite(thing.width), _finite(thing.length)]
        fields["speed_mm_s"] = round(float(np.linalg.norm(target.velocity)) * _MM, 1)
    return fields


def picture_fields(cycle: LoopCycle, side: int, rig: Rig) -> dict[str, Any]:
    """What is drawn into one picture; px, centres at whole numbers."""
    assert cycle.pair is not None
    pair, observation = cycle.pair, cycle.observation
    height, width = (pair.left, pair.right)[side].shape[:2]
    found: dict[str, Any] = {"width": width, "height": height, "target": None}
    if observation is None:
        return found
    camera, pan = ((rig.left, pair.pan_left), (rig.right, pair.pan_right))[side]
    found["target"] = {
        "status": observation.status,
        "window": observation.windows[side],
        "outline": _ellipse((observation.left, observation.right)[side]),
        "place": None,
    }
    if np.isfinite(observation.centre).all():
        before = carry(invert(camera.rig_T_camera(pan)), observation.centre)
        if before[2] > 0:
            found["target"]["place"] = np.round(camera.project(before), 1).tolist()
    return found


def _ellipse(blob: Blob | None) -> dict[str, Any] | None:
    if blob is None:
        return None
    *axes, angle = blob.ellipse
    return {
        "centre": np.round(blob.centre, 1).tolist(),
        "axes": [round(axis, 1) for axis in axes],
        "angle_deg": round(float(np.degrees(angle)), 1),
    }


def _finite(length: float) -> float | None:
    return round(length * _MM, 1) if np.isfinite(length) else None


@dataclass(frozen=True, slots=True)
class GraspFacts:
    """What never changes."""

    robot: str
    description: str
    setup: Workspace
    rig: Rig
    execute: bool
    duration: float  # s, the longest it may take


@dataclass(frozen=True, slots=True)
class LoopSnapshot:
    """One turn of the loop, as it was when it ended."""

    at: float  # s, this computer's monotonic clock
    cycle: LoopCycle
    passages: tuple[states.StateChange, ...]
    planned: GraspPlan | GraspRefusal | None
    lacks: str | None  # for the grab; empty: it may be ordered; None: it is no order in this state
    may_choose: bool
    selected: bool  # there is a target to look for
    lines: tuple[tuple[str, bool, str], ...]  # devices: name, well, in words; the cameras first


class GraspPageSource:
    """Keeps the newest turn; nothing waits for it."""

    def __init__(self, facts: GraspFacts) -> None:
        self._facts = facts
        self._shown: LoopSnapshot | None = None
        self._pictured: LoopCycle | None = None  # the newest with pictures
        self._began: float | None = None
        self._answers = 0
        self._answer = ""
        self._stops = 0
        self._finished = ""
        self._row: dict[str, Any] = {}
        self._frame: int | None = None
        self._drawn: tuple[GraspPlan, dict[str, Any]] | None = None

    def show(self, cycle: LoopCycle, loop: GraspLoop, stops: int) -> None:
        """Take a cycle of the loop, before the next one."""
        machine, planned, grab = loop.machine, loop.aim.planned, states.GraspEvent.GRAB
        self._began = cycle.t if self._began is None else self._began
        self._stops = stops
        if cycle.pair is not None:
            self._pictured = cycle
        devices = device_status(cycle, loop, self._facts.setup.cell.watch)
        self._shown = LoopSnapshot(
            time.monotonic(),
            cycle,
            tuple(machine.log),
            None if planned is None else planned.answer,
            machine.lacks(grab) if (machine.state, grab) in states.TRANSITIONS_BY_EVENT else None,
            loop.may_choose,
            loop.selected,
            devices,
        )

    def answer(self, text: str) -> None:
        """Show what became of a request."""
        self._answer, self._answers = text, self._answers + 1

    def end(self, text: str) -> None:
        """Show how it ended."""
        self._finished = text

    def hello(self) -> dict[str, Any]:
        """What never changes."""
        facts = self._facts
        return {
            "mode": "grab",
            "title": facts.robot,
            "description": facts.description[:MAX_TEXT_LENGTH],
            "execute": facts.execute,
            "duration_s": facts.duration,
            "cameras": camera_poses(facts.rig, None),
        }

    def rows(self) -> list[dict[str, Any]]:
        """How it stands now, if that is news."""
        shown = self._shown
        if shown is None:
            return []
        cycle = shown.cycle
        row = {
            "elapsed_s": round(cycle.t - (self._began or 0.0), 1),
            "state": cycle.state.value,
            "reason": cycle.reason,
            "moving": cycle.state in states.MOVING_STATES,
            "passages": len(shown.passages),
            "grab_lacks": shown.lacks,
            "may_choose": shown.may_choose,
            **target_fields(
                None if self._pictured is None else self._pictured.observation,
                selected=shown.selected,
                fresh=shown.lines[0][1],
            ),
            **object_fields(cycle),
            "q_deg": None if cycle.q is None else np.round(np.degrees(cycle.q), 2).tolist(),
            "scene": self._scene(cycle),
            "stops": self._stops,
            "answers": self._answers,
            "answer": self._answer,
            "finished": self._finished,
        }
        news = [] if row == self._row else [row]
        self._row = row
        return news

    def state(self) -> dict[str, Any]:
        """The plan, the last passages, the devices; and whether the loop still turns."""
        shown = self._shown
        if shown is None:
            return {"plan": None, "way": None, "passages": [], "devices": [], "silent_s": 0.0}
        silent = 0.0 if self._finished else time.monotonic() - shown.at
        return {
            "plan": None if shown.planned is None else plan_fields(shown.planned),
            "way": self._way(shown.planned),
            "passages": [
                {
                    "elapsed_s": round(passage.t - (self._began or 0.0), 2),
                    "state": passage.target.value,
                    "event": passage.event.value,
                    "reason": passage.reason,
                }
                for passage in shown.passages[: -MAX_STATE_CHANGES - 1 : -1]
            ],
            "devices": [{"name": n, "well": well, "sentence": s} for n, well, s in shown.lines],
            "silent_s": round(silent, 1) if silent > SILENCE_TIMEOUT else 0.0,
        }

    def alarms(self) -> Sequence[dict[str, Any]]:
        """There are none: what is wrong is a state."""
        return ()

    def pictures(self) -> Sequence[tuple[int, dict[str, Any], bytes]]:
        """The newest pair, if it was not given yet."""
        cycle = self._pictured
        if cycle is None or cycle.pair is None or cycle.pair.frame == self._frame:
            return ()
        pair = cycle.pair
        self._frame = pair.frame
        return [
            (side, picture_fields(cycle, side, self._facts.rig), small_jpeg(image))
            for side, image in enumerate((pair.left, pair.right))
        ]

    def metrics(self) -> str:
        """State and target, for Prometheus."""
        shown = self._shown
        if shown is None:
            return ""
        observation = None if self._pictured is None else self._pictured.observation
        quality = 0.0 if observation is None else observation.quality
        return (
            "# TYPE verify_grab_state gauge\n"
            f'verify_grab_state{{state="{shown.cycle.state.value}"}} 1\n'
            "# TYPE verify_grab_target_quality_ratio gauge\n"
            f"verify_grab_target_quality_ratio {quality:.4f}\n"
        )

    def _scene(self, cycle: LoopCycle) -> dict[str, Any]:
        """Arm as read, the target, and the cameras as they stood for the pictures shown."""
        pair = None if self._pictured is None else self._pictured.pair
        scene: dict[str, Any] = {"cameras": camera_poses(self._facts.rig, pair)}
        if cycle.q is not None:
            scene["arm_mm"] = millimetres(joint_origins(self._facts.setup.arm, cycle.q))
        if cycle.target is not None:
            scene["target_mm"] = millimetres(cycle.target.thing.position[None])[0]
        return scene

    def _way(self, planned: GraspPlan | GraspRefusal | None) -> dict[str, Any] | None:
        """The arm at the object, and the grip point's way there; drawn once a plan."""
        if not isinstance(planned, GraspPlan):
            return None
        if self._drawn is None or self._drawn[0] is not planned:
            setup = self._facts.setup
            ways = (*planned.over, planned.down)
            turns = np.concatenate([w.sampled(w.duration / N_PATH_POINTS)[1].q for w in ways])
            drawn = {
                "arm_mm": millimetres(joint_origins(setup.arm, planned.posture.q_grip)),
                "grip_mm": millimetres(setup.grip(turns)[:, :3, 3]),
            }
            self._drawn = planned, drawn
        return self._drawn[1]
