"""List and score every posture in which the arm could grasp, and say why the others cannot.

Model: of each branch of the inverse and each of N_TURNS turns of the hand about the approach,

    score = limits * dexterity * nearness * clearance,   each from MIN_SCORE to 1

    limits     least distance of a joint from its limits, in half ranges
    dexterity  least singular value of the Jacobian / GOOD_SINGULAR_VALUE
    nearness   1 / (1 + time from the present posture / HALF_SCORE_TIME)
    clearance  least clearance of upper arm, elbow and forearm / GOOD_CLEARANCE
"""

from dataclasses import dataclass

import numpy as np

import robots
from robots.coupling import LENGTH_SCALE
from robots.inverse import near, near_within
from robots.trajectory import JointLimits
from robots.transforms import invert
from verify.core.records import Array, Index
from verify.grasping.planning.approach import hand_poses, nearest_turn
from verify.grasping.planning.workspace import LINKS, RESOLUTION, Workspace

N_TURNS = 24  # of the hand about the approach, 15° apart; the first is the one it has now
MIN_SINGULAR_VALUE = 0.02  # least singular value of J, lengths over 143 mm: below, joints race
GOOD_CLEARANCE = 0.1  # m of clearance that is as good as any more
GOOD_SINGULAR_VALUE = 0.3  # singular value that is as good as any more
HALF_SCORE_TIME = 1.0  # s at full speed: a posture so far off counts half
SINGULAR_STAGE, VALID_STAGE = 2, 4  # of _PostureTable.stage
CHECKED_LINKS = LINKS[:-1]  # the wrist's link and the hand stand alike in every posture of a grasp
END_NAMES = ("above the object", "at the object")
MIN_SCORE = 1e-3  # of each score: at its edge postures still differ


@dataclass(frozen=True, slots=True)
class Posture:
    """One way to stand above the object and at it."""

    branch: int  # of robots.inverse
    turn: float  # rad, of the hand about the approach
    q_above: Array  # (n,), rad, where the line begins
    q_grip: Array  # (n,), rad, where it ends; its branch, turns of joints near q_above
    limits: float  # the four scores, 0 to 1
    dexterity: float
    nearness: float
    clearance: float

    @property
    def score(self) -> float:
        """The four multiplied."""
        return self.limits * self.dexterity * self.nearness * self.clearance


def branch_name(branch: int) -> str:
    """Say which of the eight branches it is: branch = 4 · shoulder + 2 · elbow + wrist."""
    shoulder = "away" if branch & 4 else "facing"
    elbow, wrist = ("−" if branch & bit else "+" for bit in (2, 1))
    return f"shoulder {shoulder}, elbow {elbow}, wrist {wrist}"


@dataclass(frozen=True, slots=True)
class _PostureTable:
    """All postures of a grasp, (k, 8): the hand's turns times the branches; nan where none."""

    q: Array  # (2, k, 8, n), rad, above the object and at it
    beyond: Array  # rad by which the worst joint is beyond its limits; below 0 within
    singular: Array  # the smaller of both ends' least singular values of J
    margin: Array  # m, the smaller of both ends' least clearances
    room: Array  # m, likewise, of those links alone in which the branches differ

    @property
    def stage(self) -> Index:
        """How far each came: 0 no answer, 1 beyond limits, 2 singular, 3 not clear, 4 good."""
        passed = (
            np.isfinite(self.beyond),
            self.beyond <= 0,
            self.singular >= MIN_SINGULAR_VALUE,
            self.margin >= -RESOLUTION,
        )
        return np.asarray(np.cumprod(passed, axis=0).sum(axis=0))


def find_postures(
    workspace: Workspace, point: Array, q_now: Array
) -> tuple[list[Posture], dict[int, str]]:
    """List how the arm could stand above an object and at it: all branches, 24 turns of the hand.

    A posture must exist, keep the joints' limits, be off singularities and clear, at both ends of
    the line to the grip point (3,), m, base frame. The arm stands at q_now, (n,), rad. Returns
    those that can be, best score first; and why each other branch cannot, in words, for the turn of
    the hand that came farthest; branches that came farthest first.
    """
    now = nearest_turn(workspace.cell.approach.direction, workspace.grip(q_now)[:3, :3])
    turns: Array = now + np.linspace(0.0, 2 * np.pi, N_TURNS, endpoint=False)
    table = _table(workspace, point, q_now, turns)
    stage = table.stage
    good = [
        _scored_posture(table, workspace.limits, int(turn), int(branch), float(turns[turn]), q_now)
        for turn, branch in np.argwhere(stage == VALID_STAGE)
    ]
    good.sort(key=lambda posture: -posture.score)
    rejected = {
        branch: _rejection_reason(workspace, table, branch)
        for branch in np.argsort(-stage.max(axis=0), kind="stable").tolist()
        if not (stage[:, branch] == VALID_STAGE).any()
    }
    return good, rejected


def smallest_singular_value(arm: robots.DhArm, q: Array) -> Array:
    """Of the Jacobian, its lengths over 143 mm; (...) for joint angles (..., n)."""
    moves = robots.jacobian(arm, q)
    moves[..., :3, :] /= LENGTH_SCALE
    return np.asarray(np.linalg.svd(moves, compute_uv=False)[..., -1])


def _table(workspace: Workspace, point: Array, q_now: Array, turns: Array) -> _PostureTable:
    cell, arm, limits = workspace.cell, workspace.arm, workspace.limits
    approach = cell.approach
    ends = (point - approach.height * approach.direction, point)
    poses = np.array([hand_poses(approach.direction, end, turns) for end in ends])
    q = robots.inverse(arm, poses @ invert(cell.gripper.flange_T_grip), hold=q_now).q
    above = near_within(arm, q[0], q_now)
    above = np.where(np.isnan(above), near(q[0], q_now), above)  # to say by how much it is beyond
    q = np.array([above, near(q[1], above)])  # the line does not wind joints up
    exists = np.isfinite(q).all(axis=(0, -1))
    beyond, singular, margin, room = (np.full(exists.shape, np.nan) for _ in range(4))
    found = q[:, exists]
    beyond[exists] = np.maximum(limits.lower - found, found - limits.upper).max(axis=(0, 2))
    singular[exists] = smallest_singular_value(arm, found).min(axis=0)
    margins = workspace.margins(found.reshape(-1, arm.dof)).reshape(2, -1, len(workspace.names))
    margins = margins.min(axis=0)
    margin[exists] = margins.min(axis=1)
    # what all share would hide it: the tips at an object come as near to the table as they may
    differing = [name.startswith(CHECKED_LINKS) for name in workspace.names]
    room[exists] = margins[:, differing].min(axis=1)
    return _PostureTable(q, beyond, singular, margin, room)


def _scored_posture(
    table: _PostureTable, limits: JointLimits, turn: int, branch: int, angle: float, q_now: Array
) -> Posture:
    q = table.q[:, turn, branch]
    half = (limits.upper - limits.lower) / 2
    room = np.minimum(q - limits.lower, limits.upper - q) / half
    time = float((np.abs(q[0] - q_now) / limits.speed).max())
    parts = (
        float(room.min()),
        float(table.singular[turn, branch]) / GOOD_SINGULAR_VALUE,
        1 / (1 + time / HALF_SCORE_TIME),
        float(table.room[turn, branch]) / GOOD_CLEARANCE,
    )
    return Posture(branch, angle, q[0], q[1], *(min(max(part, MIN_SCORE), 1.0) for part in parts))


def _rejection_reason(workspace: Workspace, table: _PostureTable, branch: int) -> str:
    """Why a branch has no posture, of its turn of the hand that came farthest."""
    stage = table.stage[:, branch]
    farthest = int(stage.max())
    if farthest == 0:
        return "out of reach, however the hand is turned"
    value = (table.beyond, table.singular, table.margin)[farthest - 1][:, branch]
    better = -value if farthest == 1 else value
    turn = int(np.argmax(np.where(stage == farthest, better, -np.inf)))
    ends = table.q[:, turn, branch]
    if farthest == 1:
        return next(
            f"{end} {problem}"
            for end, q in zip(END_NAMES, ends, strict=True)
            if (problem := workspace.limit_violation(q))
        )
    if farthest == SINGULAR_STAGE:
        singular = [robots.coupled(workspace.arm, q) for q in ends]
        factor = next((found.factor for found in singular if found), "arm")
        return f"next to a singularity ({factor})"
    margins = workspace.margins(ends)
    end = int(np.argmin(margins.min(axis=1)))
    return f"{END_NAMES[end]} {workspace.trouble(margins[end])}"
