"""Define what a plan is requested to show, the conditions of the next session, and its setup."""

from dataclasses import dataclass

import numpy as np

from robots import Arm
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Rig

FAULT_KINDS = ("offsets", "gains", "backlash", "eccentricity", "kinematics", "clock")
DEFAULT_KINDS = ("offsets", "gains", "backlash", "clock")


@dataclass(frozen=True, slots=True)
class PlanningSetup:
    """Arm, cameras and LEDs; the camera bases stand as the rig has them."""

    arm: Arm
    rig: Rig
    marker: Marker


@dataclass(frozen=True, slots=True)
class SessionConditions:
    """Assumed conditions of the next session."""

    rate: float = 10.0  # stereo pairs a second
    skew: float = 0.0  # s, right picture after the left
    spot_noise: float = 0.05  # px, standard uncertainty of a spot's centre, each coordinate
    reading_rate: float = 50.0  # encoder readings a second
    reading_noise: float = float(np.deg2rad(0.01))  # rad, standard deviation of a reading
    clock_uncertainty: float | None = None  # s, of a clock that is given; None: from the motion


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """What the motion is to show, and within which bounds."""

    observe: tuple[str, ...] = DEFAULT_KINDS
    poses: int | None = 12  # None: as many as the duration allows
    duration: float | None = None  # s
    hold: float = 0.5  # s of rest at each pose
    speed: float = float(np.deg2rad(30.0))  # rad/s, the most of any joint
    view_angle: float = float(np.deg2rad(60.0))  # of the LEDs, from the flange's z
    floor: float = 0.0  # m, base frame: nothing of the arm below
    near: Array | None = None  # (j,), rad, a posture to stay about
    within: float = float(np.deg2rad(45.0))  # rad, of each joint, about `near`
    seed: int = 0
