"""The measured poses of a session as arrays in the robot's base frame: the seam to the tables."""

from dataclasses import dataclass

import numpy as np

from verify.records import Array, Measurement
from verify.rig import Rig


@dataclass(frozen=True, slots=True)
class Track:
    """n measured pairs. Twists are (translation, rotation vector) in base axes at the flange."""

    frame: Array  # (n,), int
    t: Array  # (n,), s, the left camera's instant
    pan: Array  # (n, 2), rad, as read
    base_T_flange: Array  # (n, 4, 4)
    covariance_pixels: Array  # (n, 6, 6), m and rad
    covariance_alignment: Array  # (n, 6, 6)
    twist: Array  # (n, 6), m/s, rad/s, as the images show it
    acceleration_prior: Array  # (n, 2), m/s², rad/s²
    systematic: Array  # (n, 6, p): d measured pose / d parameter of `Systematics`
    determined: tuple[Array, ...]  # n of (6, d)

    def __len__(self) -> int:
        """Count the measured pairs."""
        return len(self.frame)

    @property
    def known_dof(self) -> Array:
        """Degrees of freedom determined in each pair, (n,)."""
        return np.array([b.shape[1] for b in self.determined], dtype=np.int64)


def collect(measurements: list[Measurement], rig: Rig, systematic: list[Array]) -> Track:
    """Gather what was measured; `systematic` holds (6, p) a measured pair, in base axes."""
    measured = [m for m in measurements if m.status == "measured" and m.pose is not None]
    base_T_rig = np.linalg.inv(rig.rig_T_base)
    turn = np.kron(np.eye(2), base_T_rig[:3, :3])
    n = len(measured)
    poses = [m.pose for m in measured if m.pose is not None]
    return Track(
        frame=np.array([m.frame for m in measured], dtype=np.int64),
        t=np.array([m.t for m in measured]),
        pan=np.array([[_pan(m, "left"), _pan(m, "right")] for m in measured]).reshape(n, 2),
        base_T_flange=np.array([base_T_rig @ p.rig_T_flange for p in poses]).reshape(n, 4, 4),
        covariance_pixels=_turned(turn, [p.covariance_pixels for p in poses]),
        covariance_alignment=_turned(turn, [p.covariance_alignment for p in poses]),
        twist=np.array([turn @ p.twist for p in poses]).reshape(n, 6),
        acceleration_prior=np.array([p.acceleration_prior for p in poses]).reshape(n, 2),
        systematic=np.array(systematic).reshape(n, 6, -1) if n else np.zeros((0, 6, 0)),
        determined=tuple(turn @ p.determined for p in poses),
    )


def _pan(measurement: Measurement, side: str) -> float:
    sighting = measurement.left if side == "left" else measurement.right
    return sighting.pan if sighting is not None else float("nan")


def _turned(turn: Array, matrices: list[Array]) -> Array:
    stack = np.array(matrices).reshape(-1, 6, 6)
    turned: Array = turn @ stack @ turn.T
    return turned
