"""Poses that another instrument measured, as measurements: all that follows is the cameras' own.

A pose from a file has no spots, so it carries its covariance ready made, and the stated doubts
that move it are those of the robot's base and of the body on the flange.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.readings import Readings
from verify.records import Array, Measurement, Pose
from verify.session import Instrument, Session
from verify.spot_derivatives import AXES
from verify.systematics import BODY, Systematics, stated
from verify.track import Track, collect

NOISE = "the instrument's noise"
OWN_ERRORS = "the instrument's own calibration"
BODY_SOURCE = "the body on the flange"


@dataclass(frozen=True, slots=True)
class Noise:
    """What varies from pose to pose: standard uncertainties a coordinate, in the file's axes."""

    position: Array  # (n, 3), m
    orientation: Array  # (n, 3), rad
    position_known: bool  # stated, or found in the data
    orientation_known: bool  # also where no orientation was measured

    @property
    def known(self) -> bool:
        """Nothing is left to be found, or to be taken as exact."""
        return self.position_known and self.orientation_known


@dataclass(frozen=True, slots=True)
class SeenPoses:
    """What an instrument's file gives, as the chain gives it from pictures."""

    measurements: list[Measurement]
    track: Track
    systematics: Systematics


def instrument_setup(session: Session, instrument: Instrument) -> dict[str, Any]:
    """What a reader needs to know of the instrument, JSON-able; millimetres and degrees.

    As `description.describe` words rig and marker; of these, what there is without cameras.
    """
    rig, body = session.rig, instrument.flange_T_body
    base_turn, body_turn = (
        Rotation.from_matrix(pose[:3, :3]).as_rotvec(degrees=True).tolist()
        for pose in (rig.rig_T_base, body)
    )
    return {
        "instrument": {
            "name": instrument.name,
            "poses": len(instrument.poses),
            "positions_alone": instrument.positions_alone,
        },
        "rig": {
            "instrument": instrument.name,
            "base_source": rig.base_source,
            "base_position_mm": (rig.rig_T_base[:3, 3] * 1e3).tolist(),
            "base_rotation_vector_deg": base_turn,
            "registration": rig.registration,
        },
        "marker": {
            "source": session.marker.source,
            "point_mm": (body[:3, 3] * 1e3).tolist(),
            "body_rotation_vector_deg": None if instrument.positions_alone else body_turn,
        },
    }


def noise_of(instrument: Instrument) -> Noise:
    """What the file or [poses] states; where neither does, what the last decimal leaves."""
    poses = instrument.poses
    given = poses.position_uncertainty, poses.orientation_uncertainty
    constant = instrument.position_uncertainty, instrument.orientation_uncertainty
    position, orientation = (
        own if own is not None else np.full((len(poses), 3), least if rest is None else rest)
        for own, rest, least in zip(given, constant, poses.rounding, strict=True)
    )
    known = [own is not None or rest is not None for own, rest in zip(given, constant, strict=True)]
    return Noise(position, orientation, known[0], known[1] or instrument.positions_alone)


def see_poses(
    session: Session,
    instrument: Instrument,
    readings: Readings,
    noise: Noise,
    offset: float | None = None,
) -> SeenPoses:
    """Take an instrument's poses as measured; each carries this noise.

    Args:
        session: whose robot was measured, and where it stands.
        instrument: the session's, or one with other poses.
        readings: the robot's own.
        noise: of the poses.
        offset: s, of the readings' clock as far as it is known; None: as session.toml has it.
            Where positions alone were measured the orientation follows the readings, a gauge that
            no statistic sees; the nearer, the sooner it settles.
    """
    if offset is None:
        offset = 0.0 if session.clock is None else session.clock.encoder_offset
    measurements = list(_measurements(session, instrument, readings, noise, offset))
    systematics = _stated_doubts(session, noise)
    moved = [
        _sensitivities(systematics, m.pose.rig_T_flange, session.rig.rig_T_base)
        for m in measurements
        if m.pose is not None
    ]
    return SeenPoses(measurements, collect(measurements, session.rig, moved), systematics)


def _measurements(
    session: Session, instrument: Instrument, readings: Readings, noise: Noise, offset: float
) -> Iterator[Measurement]:
    """One measured pair a pose."""
    poses, flange_T_body = instrument.poses, instrument.flange_T_body
    if poses.rotation is not None:
        rig_R_flange = poses.rotation @ flange_T_body[:3, :3].T
    else:
        there = np.clip(poses.t - offset, *readings.t[[0, -1]])
        base_T_flange = robots.forward(session.arm, readings.at(there))
        rig_R_flange = session.rig.rig_T_base[:3, :3] @ base_T_flange[:, :3, :3]
    lever = rig_R_flange @ flange_T_body[:3, 3]
    for i, t in enumerate(poses.t.tolist()):
        rig_T_flange = np.eye(4)
        rig_T_flange[:3, :3] = rig_R_flange[i]
        rig_T_flange[:3, 3] = poses.position[i] - lever[i]
        gain, determined = _point_to_flange(lever[i], alone=instrument.positions_alone)
        sigma = np.concatenate([noise.position[i], noise.orientation[i]])[: gain.shape[1]]
        pose = _pose(rig_T_flange, (gain * sigma**2) @ gain.T, determined)
        yield Measurement(frame=i, t=t, status="measured", leds_seen=0, pose=pose)


def _point_to_flange(lever: Array, *, alone: bool) -> tuple[Array, Array]:
    """How the flange moves with what was measured, and what of it is determined.

    Args:
        lever: (3,), m, from the flange to the measured point, in the instrument's axes.
        alone: the position alone was measured, else the pose.

    Returns:
        (6, 3 or 6), the flange's twist by the point's shift (and the body's turn); and (6, d),
        orthonormal.
    """
    x, y, z = lever
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # lever x .
    if not alone:
        gain = np.eye(6)
        gain[:3, 3:] = across
        return gain, np.eye(6)
    point = np.concatenate([np.eye(3), -across], axis=1)  # of a twist: rho + phi x lever
    determined = np.linalg.qr(point.T)[0]
    return determined @ np.linalg.inv(point @ determined), determined


def _pose(rig_T_flange: Array, covariance: Array, determined: Array) -> Pose:
    """A pose without spots; how it moves, no picture says."""
    return Pose(
        rig_T_flange=rig_T_flange,
        covariance_pixels=covariance,
        covariance_alignment=np.zeros((6, 6)),  # one instrument, one instant
        twist=np.full(6, np.nan),
        acceleration_prior=(np.nan, np.nan),
        determined=determined,
        gain=np.zeros((6, 0)),
        sensitivity=np.zeros((0, 2, 3)),
        curvature=np.zeros((0, 2)),
        residual=np.zeros((0, 2)),
        spot_uncertainty=np.zeros(0),
        rejected=np.zeros(0, dtype=np.bool_),
        consistent=True,
        chi2=0.0,
        degrees_of_freedom=0,
    )


def _stated_doubts(session: Session, noise: Noise) -> Systematics:
    """What is stated of the robot's base and of the body; the rest is taken as exact."""
    found = stated(session.rig, session.marker, turning=False)
    mine = [i for i, n in enumerate(found.names) if n.startswith(("robot_base.", "body."))]
    names = tuple(found.names[i] for i in mine)
    heads = {name.partition(".")[0] for name in names}
    counted = {
        "robot base": "robot_base" in heads,
        BODY_SOURCE: "body" in heads,
        NOISE: noise.known,
        OWN_ERRORS: False,
        "robot table": False,
    }
    return replace(
        found,
        names=names,
        sources=tuple(BODY_SOURCE if n.startswith("body.") else "robot base" for n in names),
        covariance=found.covariance[np.ix_(mine, mine)],
        pan=np.full(2, np.nan),
        uncounted=tuple(source for source, counts in counted.items() if not counts),
    )


def _sensitivities(parameters: Systematics, rig_T_flange: Array, rig_T_base: Array) -> Array:
    """How the measured pose in the robot's base changes with each parameter; (6, p + 2).

    As `systematics.sensitivities`; its last two columns are pan readings, which there are none of.
    """
    columns = np.zeros((6, len(parameters.names) + 2))
    for i, name in enumerate(parameters.names):
        head, _, key = name.partition(".")
        turns, axis = divmod(BODY.index(key), len(AXES))
        if head == "body":
            moved, arm = rig_T_flange[:3, axis], np.zeros(3)
        else:
            moved, arm = np.eye(3)[axis], rig_T_flange[:3, 3] - rig_T_base[:3, 3]
        # the flange's place in what holds it moves against that
        columns[:3, i] = -np.cross(moved, arm) if turns else -moved
        columns[3:, i] = -moved if turns else 0.0
    base_R_rig = rig_T_base[:3, :3].T
    columns[:3], columns[3:] = base_R_rig @ columns[:3], base_R_rig @ columns[3:]
    return columns
