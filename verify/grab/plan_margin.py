"""May the fingers go around it? Size and uncertainty of the object against the gripper."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from verify.distributions import chi2_ppf, norm_ppf
from verify.grab.cell_file import Cell
from verify.grab.plan_target import Thing
from verify.records import Array

Kind = Literal["unknown", "workspace", "width", "length", "uncertainty", "table", "reach", "way"]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why there is no grasp, as data and in words."""

    kind: Kind
    reason: str  # one sentence, millimetres and degrees
    branches: tuple[tuple[str, str], ...] = ()  # each posture's name, and why not


@dataclass(frozen=True, slots=True)
class Margin:
    """What the gripper leaves and what is needed of it, m; expanded at the cell's coverage."""

    grip: Array  # (3,), m, base frame: where the grip point is told to go
    raised: float  # from the object's middle, against the approach, to keep the tips off the table
    across: float  # by which the object may be off sideways
    across_needed: float
    along: float  # by which it may be off along the approach
    along_needed: float


def grip_point(position: Array, cell: Cell) -> tuple[Array, float]:
    """Say where to grip: the object's middle, or behind it, to keep the finger tips off the table.

    Args:
        position: (3,), m, base frame, of the middle.
        cell: with the table and the gripper.

    Returns:
        (3,), m, base frame, and how far behind the middle that is, m.
    """
    direction, hand = cell.approach.direction, cell.gripper
    down = -direction[2]
    rim = hand.radius * float(np.hypot(*direction[:2]))  # a tilted hand's lower edge
    lack = cell.table.height + cell.table.finger_clearance + rim + hand.tips * down - position[2]
    if lack <= 0:
        return position, 0.0
    raised = float(lack / down) if down > 0 else float("inf")  # sideways or up: no way out
    return position - raised * direction if down > 0 else position, raised


def grip_margin(thing: Thing, cell: Cell) -> Margin | Refusal:
    """Find where to grip, and refuse what the gripper cannot be sure to hold.

    Sideways, the object's middle and half its width must fall within the opening: the greater of
    the two sideways uncertainties, the robot's own and half the width's make one standard
    uncertainty; its factor is that of a circle (2 degrees of freedom) for the cell's coverage, an
    upper bound for every ellipse. Along the approach the object must stay between tips and palm.
    """
    hand, coverage = cell.gripper, cell.accuracy.coverage
    if not (np.isfinite(thing.position).all() and np.isfinite(thing.covariance).all()):
        return Refusal("unknown", "the target's place is not known")
    if not np.isfinite([thing.width, thing.length]).all():
        return Refusal("unknown", "the target's size is not known")
    if (outside := _outside(thing.position, cell)) is not None:
        return outside
    one, two = float(norm_ppf((1 + coverage) / 2)), float(np.sqrt(chi2_ppf(coverage, 2)))
    if thing.width > hand.opening:
        said = f"it is {_mm(thing.width)} wide; the gripper opens {_mm(hand.opening)}"
        return Refusal("width", said)
    across, along = _spread(thing, cell)
    sideways = float(np.hypot(across, thing.width_standard_uncertainty / 2))
    grip, raised = _told(thing, cell)
    if raised > hand.tips:
        said = f"it lies too flat: its middle is {_mm(_over(thing, cell))} above the table, "
        said += f"the finger tips must stay {_mm(cell.table.finger_clearance)} above it"
        return Refusal("table", said)
    known_across, known_along = _known_off(thing, cell)
    margin = Margin(
        grip, raised, (hand.opening - thing.width) / 2, two * sideways + known_across,
        hand.tips - raised, one * along + known_along,
    )  # fmt: skip
    return _refused(thing, cell, margin, one) or margin


def _told(thing: Thing, cell: Cell) -> tuple[Array, float]:
    """Where to tell the grip point to go, and how far behind the object's middle it will then be.

    A hand that is seen elsewhere than told is told elsewhere. The tips keep off the table both by
    what is told and by what is seen: where the arm is too high, the rest stays.
    """
    wanted, raised = grip_point(thing.position, cell)
    if thing.seen is None or thing.seen.hand is None or not thing.seen.used:
        return wanted, raised
    told, more = grip_point(wanted - thing.seen.hand.off, cell)
    return told, raised + more


def _known_off(thing: Thing, cell: Cell) -> tuple[float, float]:
    """By how much the hand is known to be off sideways and along, m, without being corrected."""
    if thing.seen is None or thing.seen.hand is None or thing.seen.used:
        return 0.0, 0.0
    off, direction = thing.seen.hand.off, cell.approach.direction
    along = float(off @ direction)
    return float(np.linalg.norm(off - along * direction)), abs(along)


def _refused(thing: Thing, cell: Cell, margin: Margin, one: float) -> Refusal | None:
    hand, percent = cell.gripper, f"{cell.accuracy.coverage:.0%}"
    room = hand.finger_length - hand.tips + margin.raised
    need = (thing.length + one * thing.length_standard_uncertainty) / 2 + margin.along_needed
    if need > room:
        said = f"it may reach {_mm(need)} from its middle towards the palm ({percent}); "
        return Refusal("length", said + f"there is room for {_mm(room)}")
    for what, left, needed in (
        ("sideways", margin.across, margin.across_needed),
        ("along the approach", margin.along, margin.along_needed),
    ):
        if needed > left:
            said = f"target and robot together are known within {_mm(needed)} {what} ({percent}); "
            return Refusal("uncertainty", said + f"the gripper leaves {_mm(left)}")
    return None


def _outside(point: Array, cell: Cell) -> Refusal | None:
    beyond = np.maximum(cell.lower - point, point - cell.upper)
    axis = int(np.argmax(beyond))
    if beyond[axis] <= 0:
        return None
    said = f"it lies {_mm(beyond[axis])} outside the workspace box in {'xyz'[axis]}"
    return Refusal("workspace", said)


def _spread(thing: Thing, cell: Cell) -> tuple[float, float]:
    """Standard uncertainty, the greatest sideways and that along the approach, with the robot's."""
    direction = cell.approach.direction
    total = thing.covariance + np.eye(3) * cell.accuracy.robot**2
    if thing.seen is not None and thing.seen.hand is not None:
        total = total + thing.seen.hand.covariance  # the arm need not repeat itself any better
    sideways = np.linalg.svd(direction[None])[2][1:]  # two unit vectors across the approach
    across = float(np.linalg.eigvalsh(sideways @ total @ sideways.T)[-1])
    return float(np.sqrt(across)), float(np.sqrt(direction @ total @ direction))


def _over(thing: Thing, cell: Cell) -> float:
    return float(thing.position[2] - cell.table.height)


def _mm(length: float) -> str:
    return f"{1e3 * length:.1f} mm"
