"""The worlds of a Monte-Carlo check: what is drawn of the inputs, and the poses that follow."""

from functools import cached_property

import numpy as np

from robots.transforms import invert, rotation_exp
from verify.clock import ClockEstimate
from verify.judgement.monte_carlo_poses import (
    Cameras,
    Views,
    camera_draws,
    led_draws,
    refit,
    spots_of,
)
from verify.records import Array, Measurement
from verify.session import Session
from verify.spot_derivatives import AXES
from verify.systematics import Systematics, root
from verify.track import Track


class World:
    """What is drawn once and holds for all pairs, and the chance for the rest; d draws."""

    def __init__(
        self,
        rng: np.random.Generator,
        draws: int,
        session: Session,
        systematics: Systematics,
        clock: ClockEstimate,
    ) -> None:
        self.rng, self.draws, self.session = rng, draws, session
        spread = root(systematics.covariance)
        self.stated = rng.standard_normal((draws, spread.shape[1])) @ spread.T
        self.values = dict(zip(systematics.names, self.stated.T, strict=True))
        self.late = rng.standard_normal(draws) * (clock.standard_uncertainty or 0.0)
        self.misaligned = rng.standard_normal(draws)
        self.pan_sigma = np.nan_to_num(systematics.pan)
        self._pan: dict[tuple[int, float], Array] = {}
        self._cameras: dict[tuple[int, float], Cameras] = {}

    def pan(self, side: int, reading: float) -> Array:
        """Error of a pan reading, (d,), rad; one for all pairs that share the reading."""
        key = side, reading
        if key not in self._pan:
            self._pan[key] = self.rng.standard_normal(self.draws) * self.pan_sigma[side]
        return self._pan[key]

    def camera(self, side: int, reading: float) -> Cameras:
        """One camera in every draw, for all pairs that share the pan reading."""
        key, rig = (side, reading), self.session.rig
        if key not in self._cameras:
            name, camera = (("left", rig.left), ("right", rig.right))[side]
            pan = reading + self.pan(side, reading)
            self._cameras[key] = camera_draws(camera, name, self.values, pan)
        return self._cameras[key]

    def readings(self, rate: Array, noise: Array) -> Array:
        """Errors of the readings, (d, j), rad: noise, last digit, time stamps, the clock."""
        session, shape = self.session, (self.draws, len(rate))
        error = self.rng.standard_normal(shape) * noise - np.outer(self.late, rate)
        if session.encoder_resolution is not None:
            error += session.encoder_resolution * self.rng.uniform(-0.5, 0.5, shape)
        stamps = session.encoder_time_standard_uncertainty
        if stamps is not None:
            error += np.outer(stamps * self.rng.standard_normal(self.draws), rate)
        return error

    def poses(self, seen: Measurement, track: Track, row: int, scale: float) -> tuple[Array, Array]:
        """The flange in the base, (d, 4, 4), and what linear propagation makes of it, (d, 6)."""
        if seen.pose is None:
            raise ValueError("only a measured pair has a pose")
        if seen.left is None or seen.right is None:
            rig_T_flange, twist = self._instrument(seen.pose.rig_T_flange, track, row)
        else:
            rig_T_flange, twist = self._pictures(seen, track, row, scale)
        count = len(self.values)
        twist = twist + self.stated @ track.systematic[row][:, :count].T
        return self._base_T_rig @ rig_T_flange, twist

    def _pictures(
        self, seen: Measurement, track: Track, row: int, scale: float
    ) -> tuple[Array, Array]:
        rig, pose = self.session.rig, seen.pose
        assert pose is not None
        spots = spots_of(seen, rig, self.session.marker)
        moved = self.rng.standard_normal((self.draws, len(spots.noise))) @ spots.noise.T
        prior = np.repeat(pose.acceleration_prior, 3) * scale
        moved += self.rng.standard_normal((self.draws, 6)) * prior @ spots.by_acceleration.T
        pan = [self.pan(side, float(reading)) for side, reading in enumerate(track.pan[row])]
        left, right = (
            self.camera(side, float(reading)) for side, reading in enumerate(track.pan[row])
        )
        poses = refit(
            pose.rig_T_flange,
            self._leds[:, spots.led],
            spots.seen + moved.reshape(self.draws, -1, 2),
            Views(left, right, spots.left),
            spots.weight,
        )
        by_spots = moved @ spots.gain.T
        base_R_rig = rig.rig_T_base[:3, :3].T
        twist = np.concatenate([by_spots[:, :3] @ base_R_rig.T, by_spots[:, 3:] @ base_R_rig.T], 1)
        return poses, twist + np.stack(pan, axis=1) @ track.systematic[row][:, -2:].T

    def _instrument(self, rig_T_flange: Array, track: Track, row: int) -> tuple[Array, Array]:
        """Another instrument's pose: its noise, and where the body sits on the flange."""
        lower = np.linalg.cholesky(track.covariance_pixels[row])
        twist = self.rng.standard_normal((self.draws, 6)) @ lower.T  # base axes
        rig_R_base = self.session.rig.rig_T_base[:3, :3]
        poses = np.tile(rig_T_flange, (self.draws, 1, 1))
        body = np.tile(np.eye(4), (self.draws, 1, 1))
        body[:, :3, :3] = rotation_exp(self._three("body.r", "deg"))
        body[:, :3, 3] = self._three("body.", "mm")
        poses = poses @ invert(body)
        poses[:, :3, :3] = rotation_exp(twist[:, 3:] @ rig_R_base.T) @ poses[:, :3, :3]
        poses[:, :3, 3] += twist[:, :3] @ rig_R_base.T
        return poses, twist

    @cached_property
    def _leds(self) -> Array:
        """Where the LEDs sit on the flange in every draw, (d, leds, 3), m."""
        return led_draws(self.session.marker, self.values, self.draws)

    @cached_property
    def _base_T_rig(self) -> Array:
        """The rig in the robot's base in every draw, (d, 4, 4)."""
        base = np.tile(self.session.rig.rig_T_base, (self.draws, 1, 1))
        base[:, :3, :3] = rotation_exp(self._three("robot_base.r", "deg")) @ base[:, :3, :3]
        base[:, :3, 3] += self._three("robot_base.", "mm")
        return invert(base)

    def _three(self, stem: str, suffix: str) -> Array:
        zero = np.zeros(self.draws)
        return np.stack([self.values.get(f"{stem}{a}_{suffix}", zero) for a in AXES], axis=1)

    def aligned(self, poses: Array, error: Array) -> tuple[Array, Array]:
        """Move poses against what alignment may have left, (6,) of xi; and that, (d, 6)."""
        left = np.outer(self.misaligned, error)
        moved = poses.copy()
        moved[:, :3, 3] -= left[:, :3]
        moved[:, :3, :3] = rotation_exp(-left[:, 3:]) @ moved[:, :3, :3]
        return moved, left
