"""What a grab's page is told, as JSON has it: millimetres, degrees, pixels, seconds."""

from typing import TYPE_CHECKING, Any

import numpy as np

from robots.transforms import carry, invert
from verify.grab.cell_file import WatchLimits
from verify.grab.states import Event
from verify.grab.states_machine import WAYS, Machine
from verify.grab.target import Outline, TargetSeen
from verify.records import Array
from verify.rig import Rig

if TYPE_CHECKING:  # types alone: what they come from can move an arm
    from verify.grab.loop import Loop
    from verify.grab.loop_record import Cycle

_MM = 1e3  # of a metre


def grab_lacks(machine: Machine) -> str | None:
    """What the grab waits for; empty: it may be ordered; None: it is no order in this state."""
    if (machine.state, Event.GRAB) not in WAYS:
        return None
    return ", ".join(sorted(need.value for need in machine.lacks(Event.GRAB)))


def device_lines(
    cycle: "Cycle", loop: "Loop", watch: WatchLimits
) -> tuple[tuple[str, bool, str], ...]:
    """Say of each device its name, whether it is well, and how it is; the cameras come first."""
    arm, fingers = loop.arm, cycle.gripper
    lines = [
        _aged("cameras", cycle.t, loop.pictures_t, watch.stale),
        _aged("joints", cycle.t, loop.joints_t, watch.joints),
    ]
    if not loop.may_move:
        return (*lines, ("arm", True, "is read, and not moved: there is no --execute"))
    if arm is not None:
        speed = "" if arm.speed is None else f"{_MM * arm.speed:.0f} mm/s"
        lines.append(("arm", arm.state != "failed", _joined(arm.state.value, speed, arm.reason)))
    if fingers is not None:
        opening = "" if fingers.opening is None else f"{_MM * fingers.opening:.0f} mm open"
        words = _joined(fingers.state.value, opening, fingers.reason)
        lines.append(("gripper", fingers.state not in ("failed", "lost"), words))
    return tuple(lines)


def _aged(name: str, now: float, t: float | None, limit: float) -> tuple[str, bool, str]:
    if t is None:
        return name, False, "nothing has come yet"
    old = max(now - t, 0.0)
    return name, old <= limit, f"{old:.2f} s old; {limit:g} s are allowed"


def _joined(*parts: str) -> str:
    return ", ".join(part for part in parts if part)


def seen_fields(seen: TargetSeen | None, *, fresh: bool) -> dict[str, Any]:
    """What the newest pictures say of the target, and how well it is seen."""
    if seen is None:
        return {"status": None, "unseen_because": "", "quality": None}
    if not fresh:
        return {"status": "not seen", "unseen_because": "the pictures are old", "quality": None}
    return {
        "status": seen.status,
        "unseen_because": seen.reason,
        "quality": round(float(seen.quality), 3) if np.isfinite(seen.quality) else None,
    }


def known_fields(cycle: "Cycle") -> dict[str, Any]:
    """Where the target is in the base, how well that is known, and how big it is."""
    known = cycle.known
    told: dict[str, Any] = {"position_mm": None}
    if known is not None and np.isfinite(known.thing.covariance).all():
        thing = known.thing
        told["position_mm"] = _rounded(thing.position)
        told["standard_uncertainty_mm"] = _rounded(np.sqrt(np.diag(thing.covariance)))
        told["size_mm"] = [_finite(thing.width), _finite(thing.length)]
        told["speed_mm_s"] = round(float(np.linalg.norm(known.velocity)) * _MM, 1)
    return told


def found_fields(cycle: "Cycle", side: int, rig: Rig) -> dict[str, Any]:
    """What is drawn into one picture; px, centres at whole numbers."""
    assert cycle.pair is not None
    pair, seen = cycle.pair, cycle.seen
    height, width = (pair.left, pair.right)[side].shape[:2]
    found: dict[str, Any] = {"width": width, "height": height, "target": None}
    if seen is None:
        return found
    camera, pan = ((rig.left, pair.pan_left), (rig.right, pair.pan_right))[side]
    found["target"] = {
        "status": seen.status,
        "window": seen.windows[side],
        "outline": _ellipse((seen.left, seen.right)[side]),
        "place": None,
    }
    if np.isfinite(seen.centre).all():
        before = carry(invert(camera.rig_T_camera(pan)), seen.centre)
        if before[2] > 0:
            found["target"]["place"] = np.round(camera.project(before), 1).tolist()
    return found


def _ellipse(outline: Outline | None) -> dict[str, Any] | None:
    if outline is None:
        return None
    return {
        "centre": np.round(outline.centre, 1).tolist(),
        "axes": [round(float(axis), 1) for axis in outline.axes],
        "angle_deg": round(float(np.degrees(outline.angle)), 1),
    }


def _rounded(metres: Array) -> list[float]:
    return [round(float(v) * _MM, 2) for v in metres]


def _finite(length: float) -> float | None:
    return round(length * _MM, 1) if np.isfinite(length) else None


def degrees(q: Array | None) -> list[float] | None:
    """Write joint angles (n,), rad."""
    return None if q is None else [round(float(v), 2) for v in np.degrees(q)]
