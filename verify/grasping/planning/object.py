"""Carry the tracked object into the robot's base, and check that the gripper is sure to hold it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from robots.transforms import carry, cross_matrix, invert
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, Array
from verify.core.rig import Rig
from verify.core.statistics import chi2_ppf, norm_ppf
from verify.grasping.cell import Cell
from verify.grasping.tool_offset.offset import OffsetMeasurement, ToolOffset
from verify.grasping.tracking.target import TargetObservation
from verify.measurement.systematics import stated_systematics

NO_LEDS = Marker((), np.zeros((0, 3)), (), 0.0)
MIN_UPRIGHT_COSINE = 0.7  # |cosine|: from there a picture's columns run along the approach


@dataclass(frozen=True, slots=True)
class GraspObject:
    """An object to grasp, in the robot's base frame."""

    position: Array  # (3,), m, of its middle
    covariance: Array  # (3, 3), m²: of the pictures, the rig and the robot's place in it, as stated
    width: float  # m, across the approach: what goes between the fingers
    width_standard_uncertainty: float  # m
    length: float  # m, along the approach
    length_standard_uncertainty: float  # m
    offset: OffsetMeasurement | None = None  # of the hand, measured above it; None: it was not

    @property
    def hand(self) -> ToolOffset | None:
        """The hand's offset; None: nothing is known beside the claimed accuracy."""
        return None if self.offset is None else self.offset.hand


def point_in_base(rig: Rig, point: Array, covariance: Array) -> tuple[Array, Array]:
    """Carry a point of the rig into the robot's base, with its covariance.

    The robot's place in the rig adds what rig.toml states of it (`robot_base.*`, a small rotation
    on the left in the rig's axes); where it states nothing, it is taken as exact. Correlations of
    that place with the cameras' own parameters are left out. A point is (3,), m, its covariance
    (3, 3), m².
    """
    base_T_rig = invert(rig.rig_T_base)
    base_R_rig = base_T_rig[:3, :3]
    total = base_R_rig @ (covariance + base_covariance(rig, point)) @ base_R_rig.T
    return carry(base_T_rig, point), total


def object_from_target(target: TargetObservation, rig: Rig, direction: Array) -> GraspObject:
    """Make the object to grasp of a tracked target.

    Its size is measured across the line of sight. Where the pictures' columns (the rig's y) run
    within 45° of the approach, their extent is the length, and the rows' is the width; else both
    extents are across it, and the greater one counts for both. The direction of the approach is a
    unit vector (3,), base frame.
    """
    position, covariance = point_in_base(rig, target.centre, target.covariance)
    size, u = target.size, target.size_standard_uncertainty
    down_rig = rig.rig_T_base[:3, :3] @ direction
    wide, long = (0, 1) if abs(down_rig[1]) > MIN_UPRIGHT_COSINE else (int(np.argmax(size)),) * 2
    return GraspObject(
        position,
        covariance,
        width=float(size[wide]),
        width_standard_uncertainty=float(u[wide]),
        length=float(size[long]),
        length_standard_uncertainty=float(u[long]),
    )


def base_covariance(rig: Rig, point: Array) -> Array:
    """Covariance (3, 3), m², rig axes, that the stated base gives its fixed point (3,), m, rig."""
    given = stated_systematics(rig, NO_LEDS, turning=False)
    places = [i for i, name in enumerate(given.names) if name.startswith("robot_base.")]
    axes = [POSE_NAMES.index(given.names[i].partition(".")[2]) for i in places]
    moves = np.hstack([np.eye(3), -cross_matrix(point - rig.rig_T_base[:3, 3])])[:, axes]
    return moves @ given.covariance[np.ix_(places, places)] @ moves.T


RefusalKind = Literal[
    "unknown", "workspace", "width", "length", "uncertainty", "table", "reach", "way"
]


@dataclass(frozen=True, slots=True)
class GraspRefusal:
    """Why there is no grasp, as data and in words."""

    kind: RefusalKind
    reason: str  # one sentence, millimetres and degrees
    branches: tuple[tuple[str, str], ...] = ()  # each posture's name, and why not


@dataclass(frozen=True, slots=True)
class GripMargin:
    """What the gripper leaves and what is needed of it, m; expanded at the cell's coverage."""

    grip: Array  # (3,), m, base frame: the ordered grip point
    raised: float  # from the object's middle, against the approach, to keep the tips off the table
    across: float  # by which the object may be off sideways
    across_needed: float
    along: float  # by which it may be off along the approach
    along_needed: float


def grip_point(position: Array, cell: Cell) -> tuple[Array, float]:
    """Say where to grip: the object's middle, or behind it, to keep the finger tips off the table.

    Both places are (3,), m, base frame; also returned is how far behind the middle it is, m.
    """
    direction, hand = cell.approach.direction, cell.gripper
    down = -direction[2]
    rim = hand.radius * float(np.hypot(*direction[:2]))  # a tilted hand's lower edge
    lack = cell.table.height + cell.table.finger_clearance + rim + hand.tips * down - position[2]
    if lack <= 0:
        return position, 0.0
    raised = float(lack / down) if down > 0 else float("inf")  # sideways or up: no way out
    return position - raised * direction if down > 0 else position, raised


def grip_margin(thing: GraspObject, cell: Cell) -> GripMargin | GraspRefusal:
    """Find where to grip, and refuse what the gripper cannot be sure to hold.

    Sideways, the object's middle and half its width must fall within the opening: the greater of
    the two sideways uncertainties, the robot's own and half the width's make one standard
    uncertainty; its factor is that of a circle (2 degrees of freedom) for the cell's coverage, an
    upper bound for every ellipse. Along the approach the object must stay between tips and palm.
    """
    hand, coverage = cell.gripper, cell.accuracy.coverage
    if not (np.isfinite(thing.position).all() and np.isfinite(thing.covariance).all()):
        return GraspRefusal("unknown", "the target's place is not known")
    if not np.isfinite([thing.width, thing.length]).all():
        return GraspRefusal("unknown", "the target's size is not known")
    beyond = np.maximum(cell.lower - thing.position, thing.position - cell.upper)
    axis = int(np.argmax(beyond))
    if beyond[axis] > 0:
        reason = f"it lies {_mm(beyond[axis])} outside the workspace box in {'xyz'[axis]}"
        return GraspRefusal("workspace", reason)
    one, two = float(norm_ppf((1 + coverage) / 2)), float(np.sqrt(chi2_ppf(coverage, 2)))
    if thing.width > hand.opening:
        reason = f"it is {_mm(thing.width)} wide; the gripper opens {_mm(hand.opening)}"
        return GraspRefusal("width", reason)
    across, along = _grip_uncertainty(thing, cell)
    sideways = float(np.hypot(across, thing.width_standard_uncertainty / 2))
    grip, raised = _commanded_grip_point(thing, cell)
    if raised > hand.tips:
        height = _mm(float(thing.position[2] - cell.table.height))
        reason = f"it lies too flat: its middle is {height} above the table, the finger tips must "
        return GraspRefusal("table", reason + f"stay {_mm(cell.table.finger_clearance)} above it")
    known_across, known_along = _known_offset(thing, cell)
    margin = GripMargin(
        grip, raised, (hand.opening - thing.width) / 2, two * sideways + known_across,
        hand.tips - raised, one * along + known_along,
    )  # fmt: skip
    return _margin_refusal(thing, cell, margin, one) or margin


def _commanded_grip_point(thing: GraspObject, cell: Cell) -> tuple[Array, float]:
    """The grip point to order, and how far behind the object's middle it will then be, m.

    A measured offset of the hand is subtracted. The tips keep off the table both by the ordered and
    by the measured place.
    """
    wanted, raised = grip_point(thing.position, cell)
    if thing.hand is None or not thing.hand.used:
        return wanted, raised
    ordered, more = grip_point(wanted - thing.hand.off, cell)
    return ordered, raised + more


def _known_offset(thing: GraspObject, cell: Cell) -> tuple[float, float]:
    """The hand's known but uncorrected offset sideways and along the approach, m."""
    if thing.hand is None or thing.hand.used:
        return 0.0, 0.0
    off, direction = thing.hand.off, cell.approach.direction
    along = float(off @ direction)
    return float(np.linalg.norm(off - along * direction)), abs(along)


def _margin_refusal(
    thing: GraspObject, cell: Cell, margin: GripMargin, one: float
) -> GraspRefusal | None:
    hand, percent = cell.gripper, f"{cell.accuracy.coverage:.0%}"
    room = hand.finger_length - hand.tips + margin.raised
    need = (thing.length + one * thing.length_standard_uncertainty) / 2 + margin.along_needed
    if need > room:
        reason = f"it may reach {_mm(need)} from its middle towards the palm ({percent}); "
        return GraspRefusal("length", reason + f"there is room for {_mm(room)}")
    for what, left, needed in (
        ("sideways", margin.across, margin.across_needed),
        ("along the approach", margin.along, margin.along_needed),
    ):
        if needed > left:
            within = f"within {_mm(needed)} {what} ({percent})"
            reason = f"target and robot together are known {within}; the gripper leaves {_mm(left)}"
            return GraspRefusal("uncertainty", reason)
    return None


def _grip_uncertainty(thing: GraspObject, cell: Cell) -> tuple[float, float]:
    """Standard uncertainty, the greatest sideways and that along the approach, with the robot's."""
    direction = cell.approach.direction
    total = thing.covariance + np.eye(3) * cell.accuracy.robot**2
    if thing.hand is not None:
        total = total + thing.hand.covariance  # the arm need not repeat itself any better
    sideways = np.linalg.svd(direction[None])[2][1:]  # two unit vectors across the approach
    across = float(np.linalg.eigvalsh(sideways @ total @ sideways.T)[-1])
    return float(np.sqrt(across)), float(np.sqrt(direction @ total @ direction))


def _mm(length: float) -> str:
    return f"{1e3 * length:.1f} mm"
