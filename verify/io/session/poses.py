"""A session whose poses another instrument measured: opened and checked, without pictures."""

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Image
from verify.core.rig import Camera, Rig
from verify.errors import InputError, one_line
from verify.io import poses as io_poses
from verify.io import rig as io_rig
from verify.io import rig as rig_file
from verify.io.poses import Poses
from verify.io.rig import nearest_pose, read_base
from verify.io.series import FrameSeries, read_encoders
from verify.io.session import keys
from verify.io.session.folder import (
    check_absorption,
    file_digests,
    load_arm,
    recording_fields,
    resolve_inside,
)
from verify.io.session.keys import PosesSessionTable, PosesTable
from verify.io.toml import key_error, not_negative
from verify.io.video import Images

_MM = 1e-3  # m
_DEG = np.pi / 180  # rad

# A rig is two cameras and the robot's place; of an instrument's, the place alone is ever asked for.
_NO_CAMERA = Camera(np.eye(3), np.zeros(5), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))


@dataclass(frozen=True, slots=True)
class Instrument:
    """Who measured the poses, what they are of, and how well they are known."""

    name: str  # as session.toml has it
    poses: Poses
    flange_T_body: Array  # (4, 4): the measured point, or body, in the flange frame
    position_uncertainty: float | None  # m, of each coordinate, where poses.csv states none
    orientation_uncertainty: float | None  # rad, likewise

    @property
    def positions_alone(self) -> bool:
        """No orientation was measured."""
        return self.poses.rotation is None


class MissingImages(Images):
    """What stands where a session has no camera; whoever asks for its images is told so."""

    def count(self, torn: bool = False) -> int:  # noqa: ARG002  # the base class's signature
        """Count the images.

        Raises:
            InputError: always.
        """
        raise self._refused()

    def images(self) -> Generator[Image]:
        """Decode the images.

        Raises:
            InputError: always.
        """
        raise self._refused()

    def _refused(self) -> InputError:
        expected = "the pictures of the LEDs are needed here"
        return InputError(
            self.path, "holds poses and no pictures", expected, "Give a session with videos."
        )


def read_pose_streams(folder: Path, path: Path) -> dict[str, Any]:
    """Read and check a session of poses: every field of a Session.

    Args:
        folder: the session's.
        path: its session.toml, which has a table [poses].

    Raises:
        InputError: as `session.open_session`.
    """
    table, warnings = keys.read_poses(path)
    arm = load_arm(folder, path, table)
    torn = table.recording == "open"
    named = {
        table.poses.file: resolve_inside(folder, path, "poses.file", table.poses.file),
        table.encoders: resolve_inside(folder, path, "encoders", table.encoders),
    }
    rig, rig_warnings = _read_base(folder, path, table, named)
    check_absorption(path, rig, arm.dof)
    poses, poses_warnings = io_poses.read(named[table.poses.file], torn)
    encoders, encoders_warnings = read_encoders(named[table.encoders], arm.dof, torn)
    instrument = _instrument(path, table.poses, poses)
    still = np.zeros(len(poses))  # no camera turns
    none = MissingImages(named[table.poses.file])
    said = (
        *warnings,
        *rig_warnings,
        *poses_warnings,
        *encoders_warnings,
        _describe_instrument(instrument),
    )
    return {
        **recording_fields(folder, table, arm),
        "rig": rig,
        "frames": FrameSeries(poses.t, poses.t, still, still),
        "encoders": encoders,
        "inputs": file_digests(folder, path, table.robot, named),
        "warnings": said,
        "left": none,
        "right": none,
        "marker": _body(path, table.poses),
        "tolerance": keys.tolerance(path, table.tolerance, arm.dof),
        "instrument": instrument,
    }


def _describe_instrument(instrument: Instrument) -> str:
    """Say in words whose poses these are."""
    what = "positions alone" if instrument.positions_alone else "poses"
    return one_line(
        f"Measured by another instrument, not by cameras: {instrument.name}, "
        f"{len(instrument.poses)} {what}. Its errors count as far as session.toml and poses.csv "
        "state them."
    )


def _read_base(
    folder: Path, path: Path, table: PosesSessionTable, named: dict[str, Path]
) -> tuple[Rig, tuple[str, ...]]:
    """Read where the robot stands in the poses' frame; `named` gains what was read for it."""
    if table.rig is not None:
        named[table.rig] = resolve_inside(folder, path, "rig", table.rig)
        return rig_file.read(named[table.rig])
    covariance = None
    if table.covariance is not None:
        for index, name in enumerate(table.covariance.parameters):
            if not name.startswith("robot_base."):
                place, expected = (
                    f"covariance.parameters[{index}]",
                    "of robot_base alone: no camera",
                )
                raise key_error(path, place, f'is "{name}"', expected, "Leave it out.")
        covariance = io_rig.check_covariance(path, table.covariance)
    base: dict[str, Any] = {"rig_T_base": np.eye(4)}
    if table.robot_base is not None:
        base = read_base(path, table.robot_base)
    return Rig((0, 0), _NO_CAMERA, _NO_CAMERA, covariance=covariance, **base), ()


def _body(path: Path, table: PosesTable) -> Marker:
    """What is measured on the flange, as a marker without LEDs."""
    stated = table.body_standard_uncertainty
    uncertainty = None
    if stated is not None:
        for key, value in msgspec.structs.asdict(stated).items():
            not_negative(path, f"poses.body_standard_uncertainty.{key}", value)
        uncertainty = np.array(msgspec.structs.astuple(stated)) * ([_MM] * 3 + [_DEG] * 3)
    return Marker(
        (), np.zeros((0, 3)), (), 0.0, source=table.source, body_standard_uncertainty=uncertainty
    )


def _instrument(path: Path, table: PosesTable, poses: Poses) -> Instrument:
    """Put together what [poses] says and what poses.csv holds."""
    flange_T_body = np.eye(4)
    flange_T_body[:3, 3] = np.array(table.point_mm) * _MM
    orientation = table.orientation_standard_uncertainty_deg
    for key in ("rotation", "orientation_standard_uncertainty_deg"):
        if poses.rotation is None and getattr(table, key) is not None:
            expected = f"{table.file} holds positions alone"
            raise key_error(path, f"poses.{key}", "is given", expected, "Leave it out.")
    if table.rotation is not None:
        flange_T_body[:3, :3] = nearest_pose(
            path, "poses.rotation", table.rotation, table.point_mm
        )[:3, :3]
    position = table.position_standard_uncertainty_mm
    return Instrument(
        name=table.instrument,
        poses=poses,
        flange_T_body=flange_T_body,
        position_uncertainty=None if position is None else position * _MM,
        orientation_uncertainty=keys.to_radians(orientation),
    )
