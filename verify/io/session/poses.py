"""A session whose poses another instrument measured: opened and checked, without pictures."""

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Image, rigid_transform
from verify.core.rig import Camera, Rig
from verify.errors import InputError, one_line
from verify.io import poses as io_poses
from verify.io import rig as io_rig
from verify.io.fiducials import body_uncertainty
from verify.io.files import digest
from verify.io.poses import Poses
from verify.io.series import FrameSeries, read_encoders
from verify.io.session import folder, keys
from verify.io.session.keys import PosesSessionTable, PosesTable
from verify.io.toml import MM, key_error, scaled
from verify.io.video import Images

# A rig is two cameras and the robot's place; of an instrument's, only the place is used.
_NO_CAMERA = Camera(np.eye(3), np.zeros(5), np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.0, np.eye(4))


@dataclass(frozen=True, slots=True)
class Instrument:
    """An instrument, the poses that it measured, and their standard uncertainty."""

    name: str  # as session.toml has it
    poses: Poses
    flange_T_body: Array  # (4, 4): the measured point, or body, in the flange frame
    position_uncertainty: float | None  # m, of each coordinate, where poses.csv states none
    orientation_uncertainty: float | None  # rad, about each axis, where poses.csv states none
    placed: bool = True  # session.toml says where the point is on the flange

    @property
    def positions_alone(self) -> bool:
        """No orientation was measured."""
        return self.poses.rotation is None


class MissingImages(Images):
    """Images of a session without cameras: refused when they are read."""

    def count(self, torn: bool = False) -> int:  # noqa: ARG002  # the base class's signature
        """Refuse."""
        raise self._refusal()

    def images(self) -> Generator[Image]:
        """Refuse."""
        raise self._refusal()

    def _refusal(self) -> InputError:
        expected = "the pictures of the LEDs are needed here"
        remedy = "Give a session with videos."
        return InputError(self.path, "holds poses and no pictures", expected, remedy)


def read_pose_streams(
    path: Path, *, registered: bool = True, placed: Path | None = None
) -> dict[str, Any]:
    """Read and check a session of poses: every field of a Session; InputError names the place.

    With `registered` False base and target need not be placed. `placed` is the session.toml of
    another session of poses, whose base and target count in place of its own.
    """
    table, warnings = keys.read_poses(path, registered=registered and placed is None)
    if placed is not None:
        table, notes = _with_places(table, placed)
        warnings += notes
    arm = folder.load_arm(path, table)
    torn = table.recording == "open"
    named = {
        table.poses.file: folder.resolve_inside(path, "poses.file", table.poses.file),
        table.encoders: folder.resolve_inside(path, "encoders", table.encoders),
    }
    rig, rig_warnings = _read_base(path, table, named)
    folder.check_absorption(path, rig, arm.dof)
    poses, poses_warnings = io_poses.read(named[table.poses.file], torn)
    still = np.zeros(len(poses))  # no camera turns
    frames = FrameSeries(poses.t, poses.t, still, still, timed=poses.timed)
    visits = frames
    if poses.target is not None and not poses.timed:  # a reading for all targets of a visit
        t = np.unique(poses.t)
        visits = FrameSeries(t, t, 0 * t, 0 * t, timed=False)
        if len(poses) != len(t) * len(np.unique(poses.target)):
            found = "has no times, and not as many rows of each target"
            expected = "without t_s each visit has a row of every target"
            raise InputError(named[table.poses.file], found, expected, "Add t_s to both files.")
    encoders, encoders_warnings = read_encoders(
        named[table.encoders], arm.dof, torn, (arm.lower, arm.upper), visits
    )
    instrument = _instrument(path, table.poses, poses)
    none = MissingImages(named[table.poses.file])
    other = {} if placed is None else {str(placed): digest(placed)}
    notes = (*warnings, *rig_warnings, *poses_warnings, *encoders_warnings)
    return {
        **folder.recording_fields(path, table, arm, timed=poses.timed),
        "rig": rig,
        "frames": frames,
        "encoders": encoders,
        "inputs": folder.file_digests(path, table.robot, named) | other,
        "warnings": (*notes, _describe_instrument(instrument)),
        "left": none,
        "right": none,
        "marker": _body(path, table.poses),
        "tolerance": keys.tolerance(path, table.tolerance, arm.dof),
        "instrument": instrument,
    }


def _with_places(
    table: PosesSessionTable, placed: Path
) -> tuple[PosesSessionTable, tuple[str, ...]]:
    """Put another session's base and target into this one's table; warnings of the other."""
    other, warnings = keys.read_poses(placed)
    if other.poses.frame != "instrument" or table.poses.frame == "rig":
        found = f'poses.frame is "{other.poses.frame}"'
        expected = 'a session that `verify calibrate register` wrote, "instrument"'
        raise InputError(placed, found, expected, "Give its folder.")
    names = ("point_mm", "rotation", "source", "body_standard_uncertainty")
    target = {name: getattr(other.poses, name) for name in names}
    poses = msgspec.structs.replace(table.poses, frame="instrument", **target)
    places = {"robot_base": other.robot_base, "covariance": other.covariance}
    return msgspec.structs.replace(table, poses=poses, **places), warnings


def _describe_instrument(instrument: Instrument) -> str:
    what = "positions alone" if instrument.positions_alone else "poses"
    return one_line(
        f"Measured by another instrument, not by cameras: {instrument.name}, "
        f"{len(instrument.poses)} {what}. Its errors count as far as session.toml and poses.csv "
        "state them."
    )


def _read_base(
    path: Path, table: PosesSessionTable, named: dict[str, Path]
) -> tuple[Rig, tuple[str, ...]]:
    """Read where the robot stands in the poses' frame; a file read for it is added to `named`."""
    if table.rig is not None:
        named[table.rig] = folder.resolve_inside(path, "rig", table.rig)
        return io_rig.read(named[table.rig])
    covariance = None
    if table.covariance is not None:
        for index, name in enumerate(table.covariance.parameters):
            if not name.startswith("robot_base."):
                place = f"covariance.parameters[{index}]"
                expected = "of robot_base alone: no camera"
                raise key_error(path, place, f'is "{name}"', expected, "Leave it out.")
        covariance = io_rig.check_covariance(path, table.covariance)
    base: dict[str, Any] = {"rig_T_base": np.eye(4)}
    if table.robot_base is None and table.poses.frame == "instrument":
        base["base_source"] = ""  # nobody knows where
    if table.robot_base is not None:
        base = io_rig.read_base(path, table.robot_base)
    return Rig((0, 0), _NO_CAMERA, _NO_CAMERA, covariance=covariance, **base), ()


def _body(path: Path, table: PosesTable) -> Marker:
    """The measured body on the flange, as a marker without LEDs."""
    u = body_uncertainty(path, "poses.body_standard_uncertainty", table.body_standard_uncertainty)
    return Marker((), np.zeros((0, 3)), (), 0.0, source=table.source, body_standard_uncertainty=u)


def _instrument(path: Path, table: PosesTable, poses: Poses) -> Instrument:
    """Combine [poses] of session.toml with poses.csv."""
    point_mm = (0.0, 0.0, 0.0) if table.point_mm is None else table.point_mm
    flange_T_body = rigid_transform(np.eye(3), np.array(point_mm) * MM)
    if poses.target is not None and table.point_mm is not None:
        found, expected = "is given", f"{table.file} has the column target: each has its own place"
        raise key_error(path, "poses.point_mm", found, expected, "Leave it out: it is identified.")
    for key in ("rotation", "orientation_standard_uncertainty_deg"):
        if poses.rotation is None and getattr(table, key) is not None:
            expected = f"{table.file} holds positions alone"
            raise key_error(path, f"poses.{key}", "is given", expected, "Leave it out.")
    if table.rotation is not None:
        flange_T_body = io_rig.nearest_pose(path, "poses.rotation", table.rotation, point_mm)
    return Instrument(
        name=table.instrument,
        poses=poses,
        flange_T_body=flange_T_body,
        position_uncertainty=scaled(table.position_standard_uncertainty_mm, MM),
        orientation_uncertainty=keys.to_radians(table.orientation_standard_uncertainty_deg),
        placed=table.point_mm is not None,
    )
