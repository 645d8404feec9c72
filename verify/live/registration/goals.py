"""What a recording still lacks for the robot to be registered by its motion.

From the postures q_i, i = 1 … n, that the encoders read while both cameras saw the LEDs, with the
flange's poses (R_i, p_i) in the robot's base and the mean orientation R:

    w_i = log(Rᵀ R_i)      turns; their largest extent is about the first axis, the largest across
                           it about the second
    p_i                    positions; extents along their principal directions

and from all readings each joint's travel in either direction. The limits are of the motion alone:
`verify calibrate register` judges by the pictures.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.calibration.handeye import nearest_rotation
from verify.calibration.registration.led_tracks import PairSpots, candidate_points
from verify.calibration.registration.refusals import SWING_ANGLE
from verify.core.records import Array
from verify.core.rig import Rig

MIN_LEDS = 3  # in both pictures: fewer give no pose
MIN_POSTURES = 30  # ten a half for the hold-out, and spare ones
# rad, from end to end, about the first axis and the second; a joint that swings as
# `calibrate register` asks for turns twice as far about the second as it must
MIN_TURNS = (2 * float(SWING_ANGLE), float(SWING_ANGLE))
MIN_SPREAD = 0.075  # m: beyond it positions add little to what turns tell of the base
MIN_TRAVEL = np.deg2rad(10.0)  # of a joint, in either direction
# A posture is another one where the flange has turned or moved so far from all others.
NEW_TURN, NEW_SHIFT = np.deg2rad(3.0), 0.01  # rad, m
MAX_POSTURES = 500  # kept: a long recording must not grow
TRAVEL_STEP = np.deg2rad(0.5)  # less is a reading's noise


@dataclass(frozen=True, slots=True)
class RegistrationGoal:
    """Something that the motion must have, and how far it is."""

    name: str
    value: float
    target: float
    unit: str  # "" of a count
    remedy: str  # what to do while it is not reached

    @property
    def reached(self) -> bool:
        """Whether nothing is missing."""
        return self.value >= self.target

    @property
    def share(self) -> float:
        """How far it is, 0 to 1."""
        return min(self.value / self.target, 1.0)

    @property
    def words(self) -> str:
        """How far it is, and what to do."""
        # rounded down: what is shown as reached is
        text = f"{np.floor(self.value):.0f}{self.unit} of {self.target:.0f}{self.unit}"
        return text if self.reached else f"{text}; {self.remedy}"


def leds_seen(pair: PairSpots, rig: Rig | None) -> int:
    """Count the spots of a pair that may be LEDs: in both pictures, with a rig where rays meet."""
    if rig is None:
        return min(len(spots.centre) for spots in pair.spots)
    meets = candidate_points(pair, rig).spots
    return min(len(np.unique(meets[:, side])) for side in (0, 1))


class MotionCoverage:
    """The postures at which the LEDs were seen, and each joint's travel, of a recording so far."""

    def __init__(self, arm: robots.Arm) -> None:
        self._arm = arm
        self._q: Array = np.empty((0, arm.dof))
        self._flange: Array = np.empty((0, 4, 4))
        self._counted: Array | None = None  # (j,), rad: where travel was counted last
        self._travel = np.zeros((2, arm.dof))  # rad, up and down

    def moved(self, q: Array) -> None:
        """Take a reading (j,), rad, in its order."""
        if self._counted is None:
            self._counted = q.copy()
        way = q - self._counted
        far = np.abs(way) >= TRAVEL_STEP
        self._travel += np.where(far, np.maximum([way, -way], 0.0), 0.0)
        self._counted = np.where(far, q, self._counted)

    def saw(self, q: Array) -> None:
        """Take a posture (j,), rad, at which both cameras saw the LEDs."""
        if len(self._q) >= MAX_POSTURES:
            return
        flange = robots.forward(self._arm, q[None])
        if len(self._q):
            turned = Rotation.from_matrix(flange[0, :3, :3].T @ self._flange[:, :3, :3]).magnitude()
            shifted = np.linalg.norm(self._flange[:, :3, 3] - flange[0, :3, 3], axis=1)
            if np.any((turned < NEW_TURN) & (shifted < NEW_SHIFT)):
                return
        self._q = np.concatenate([self._q, q[None]])
        self._flange = np.concatenate([self._flange, flange])

    def goals(self) -> tuple[RegistrationGoal, ...]:
        """Say what the motion must have and how far it is."""
        first, second, across = self._turn_extents()
        # the second of the three extents of the flange's positions, m
        spread = _principal_extents(self._flange[:, :3, 3])[0][1] if len(self._q) > 1 else 0.0
        both = self._travel.min(axis=0)
        stuck = [f"{j + 1}" for j in np.flatnonzero(both < MIN_TRAVEL)]
        swing = f"{np.rad2deg(SWING_ANGLE):.0f}° either way"
        degrees = float(np.rad2deg(1.0))
        goals = (
            ("postures with LEDs", float(len(self._q)), MIN_POSTURES, "",
             f"show {MIN_LEDS} LEDs or more to both cameras in others"),
            ("turn about one axis", first * degrees, MIN_TURNS[0] * degrees, "°",
             f"turn the flange by {swing}"),
            ("turn about a second axis", second * degrees, MIN_TURNS[1] * degrees, "°",
             f"move joint {across} by {swing}"),
            ("positions, two directions", float(spread) * 1e3, MIN_SPREAD * 1e3, " mm",
             "move the flange up, sideways, nearer and farther"),
            ("joints moved both ways", float(self._arm.dof - len(stuck)), self._arm.dof, "",
             f"move joint{'s' * (len(stuck) > 1)} {' and '.join(stuck)} to and fro"),
        )  # fmt: skip
        return tuple(RegistrationGoal(*goal) for goal in goals)

    def _turn_extents(self) -> tuple[float, float, int]:
        """Extents about the first axis and across it, rad; the joint that turns across it most."""
        if len(self._q) < 2:
            return 0.0, 0.0, self._arm.dof
        rotations = self._flange[:, :3, :3]
        mean = nearest_rotation(rotations.mean(axis=0))
        extents, axes = _principal_extents(Rotation.from_matrix(mean.T @ rotations).as_rotvec())
        joints = robots.jacobian(self._arm, self._q.mean(axis=0))[3:].T @ mean  # flange axes
        across = np.linalg.norm(joints - np.outer(joints @ axes[0], axes[0]), axis=1)
        # of several alike the one nearest to the flange, which moves least
        best = int(np.flatnonzero(across > across.max() - 0.1)[-1])
        return float(extents[0]), float(extents[1]), best + 1


def _principal_extents(vectors: Array) -> tuple[Array, Array]:
    """Extents (3,) of vectors (n, 3) along their principal directions (3, 3), largest first."""
    centred = vectors - vectors.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1].T
    extents = np.ptp(centred @ axes.T, axis=0)
    order = np.argsort(-extents)
    return extents[order], axes[order]
