"""A recorded session: its folder opened, checked, and streamed as stereo pairs."""

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import robots
from verify.core.fiducials import Marker
from verify.core.records import Image, StereoPair, take_rows
from verify.core.rig import Rig
from verify.errors import InputError, one_line
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.files import digest
from verify.io.series import EncoderSeries, FrameSeries, read_encoders, read_frames
from verify.io.session import folder as session_folder
from verify.io.session import keys as session_keys
from verify.io.session.keys import Clock, RecordingTable, Tolerance
from verify.io.session.poses import Instrument, read_pose_streams
from verify.io.toml import key_error
from verify.io.unfinished import NAME as PENDING
from verify.io.unfinished import append_unfinished
from verify.io.video import Images, decode_in_step, open_images

_STREAMS = ("left", "right", "frames", "encoders")


@dataclass(frozen=True, slots=True)
class Recording:
    """A recorded run: keys checked, time series in memory, images on the disk."""

    folder: Path
    name: str  # the folder's own
    arm: robots.Arm
    robot: str  # as session.toml names it
    description: str
    started: str | None  # ISO 8601
    open: bool  # cut off while being written: the series end with the shortest stream
    rig: Rig
    clock: Clock | None  # None: the offset is estimated from the motion
    encoder_resolution: float | None  # rad
    encoder_time_standard_uncertainty: float | None  # s
    temperature_c: float | None
    certificate: dict[str, str]  # [certificate], by its keys
    frames: FrameSeries
    encoders: EncoderSeries
    inputs: dict[str, str]  # what was read, by its path in the folder: "sha256:…"
    warnings: tuple[str, ...]
    left: Images
    right: Images

    def __len__(self) -> int:
        return len(self.frames)

    def pairs(self) -> Generator[StereoPair]:
        """Stream the pairs in step, a few in memory; InputError: one damaged or of another size."""
        frames, lossy = self.frames, (self.left.lossy, self.right.lossy)
        series = (frames.t_left, frames.t_right, frames.pan_left, frames.pan_right)
        rows: Any = np.stack(series, axis=1).tolist()
        with closing(decode_in_step(self.left, self.right, len(self))) as images:
            for frame, (left, right) in enumerate(images):
                self._require_size(self.left, frame, left)
                self._require_size(self.right, frame, right)
                times_and_pans: tuple[float, float, float, float] = rows[frame]
                yield StereoPair(frame, *times_and_pans, left, right, lossy)

    def _require_size(self, side: Images, frame: int, image: Image) -> None:
        height, width = image.shape[:2]
        if (width, height) != self.rig.image_size:
            found = f"image {frame} is {width} x {height} px"
            expected = "the rig is calibrated for {} x {}".format(*self.rig.image_size)
            raise InputError(side.path, found, expected, "Use the rig.toml of these cameras.")


@dataclass(frozen=True, slots=True)
class Session(Recording):
    """A recording of a robot whose place and LEDs are known: all that measuring needs."""

    marker: Marker
    tolerance: Tolerance | None  # None: no verdict
    # an instrument that measured the poses in place of cameras; None: they come from the pictures
    instrument: Instrument | None = field(default=None, kw_only=True)
    # what states base and LEDs, --rig and --marker included; None: session.toml
    rig_file: Path | None = field(default=None, kw_only=True)
    marker_file: Path | None = field(default=None, kw_only=True)

    def __repr__(self) -> str:
        seen = f"{len(self)} poses" if self.instrument else f"{len(self)} pairs"
        return f"<Session {self.name}: {self.arm.name}, {seen}, {len(self.encoders.t)} readings>"


def open_session(
    folder: str | Path, *, rig: str | Path | None = None, marker: str | Path | None = None
) -> Session:
    """Open a session's folder and check all of it but the images' content.

    Its warnings name unknown keys, a recording cut off, and facts that do not fit together. `rig`
    and `marker` replace the files that session.toml names and may lie anywhere; of a session of
    poses `rig` is a registered session of poses, whose base and target count.

    Raises:
        InputError: one line that names the file, the place in it, what stands there, what should,
            and what to do.
    """
    folder = Path(folder)
    path = session_folder.find_session_file(folder)
    if session_keys.has_poses(path):
        return _open_poses(path, rig, marker)
    table, warnings = session_keys.read(path, RecordingTable)
    given = {"rig": rig, "marker": marker}
    own = tuple(key for key, other in given.items() if other is None)
    for key in own:
        if getattr(table, key) is None:
            expected = "where robot and LEDs are must be known to measure"
            remedy = f"Register first: `verify calibrate register`; then give it with --{key}."
            raise key_error(path, key, "is missing", expected, remedy)
    named = _resolve_paths(path, table, (*own, *_STREAMS))
    rig_path, marker_path = (
        named[key] if other is None else Path(other) for key, other in given.items()
    )
    arm = session_folder.load_arm(path, table)
    cameras, rig_warnings = io_rig.read(rig_path)
    leds, marker_warnings = fiducials.read_marker(marker_path)
    session_folder.check_absorption(rig_path, cameras, arm.dof)
    tolerance = session_keys.tolerance(path, table.tolerance, arm.dof)
    notes = (*warnings, *rig_warnings, *marker_warnings, *_warn_mismatch(folder, cameras, leds))
    parts = _read_streams(path, table, named, arm, cameras, notes)
    parts["inputs"] |= {str(other): digest(Path(other)) for other in given.values() if other}
    parts |= {"marker": leds, "rig_file": rig_path, "marker_file": marker_path}
    return Session(**parts, tolerance=tolerance)


def _open_poses(path: Path, rig: str | Path | None, marker: str | Path | None) -> Session:
    if marker is not None:
        raise InputError("--marker", "is given", "a session of poses has no LEDs", "Leave it out.")
    placed = None if rig is None else Path(rig)
    if placed is not None and placed.is_dir():
        placed = session_folder.find_session_file(placed)
    return Session(**read_pose_streams(path, placed=placed), rig_file=placed)


def open_poses(folder: Path) -> Session | None:
    """Open a session of poses whose base and target need not be known; None: it has pictures.

    Raises InputError as `open_session` does.
    """
    path = session_folder.find_session_file(folder)
    if not session_keys.has_poses(path):
        return None
    return Session(**read_pose_streams(path, registered=False))


def open_recording(folder: Path, *, rig: Path | None = None) -> Recording:
    """Open a session's folder to register the robot: neither its place nor its LEDs are needed.

    A marker file is not read. `rig` replaces the rig.toml that session.toml names and may lie
    anywhere; it may lack a robot base, but one that is there is read and checked.

    Raises:
        InputError: as `open_session`; a session of poses has nothing to register by.
    """
    path = session_folder.find_session_file(folder)
    if session_keys.has_poses(path):
        expected = "robot and LEDs are registered by pictures of the LEDs"
        remedy = "Open it with open_poses."
        raise key_error(path, "poses", "stands in place of pictures", expected, remedy)
    table, warnings = session_keys.read(path, RecordingTable)
    if rig is None and table.rig is None:
        expected = "the calibrated cameras are needed"
        raise key_error(path, "rig", "is missing", expected, "Name them there or with --rig.")
    named = _resolve_paths(path, table, _STREAMS if rig is not None else ("rig", *_STREAMS))
    rig_path = named["rig"] if rig is None else rig
    arm = session_folder.load_arm(path, table)
    cameras, rig_warnings = io_rig.read(rig_path, registered=False)
    parts = _read_streams(path, table, named, arm, cameras, (*warnings, *rig_warnings))
    if rig is not None:
        parts["inputs"][str(rig)] = digest(rig_path)
    return Recording(**parts)


def _resolve_paths(path: Path, table: RecordingTable, keys: tuple[str, ...]) -> dict[str, Path]:
    named = {key: session_folder.resolve_inside(path, key, getattr(table, key)) for key in keys}
    if named["left"].resolve() == named["right"].resolve():
        expected = "each camera has its own images"
        raise key_error(path, "right", f'names what left names, "{table.right}"', expected)
    return named


def _read_streams(
    path: Path,
    table: RecordingTable,
    named: dict[str, Path],
    arm: robots.Arm,
    rig: Rig,
    warnings: tuple[str, ...],
) -> dict[str, Any]:
    """Read and check the streams: every field of a Recording."""
    torn = table.recording == "open"
    frames, frames_warnings = read_frames(named["frames"], (rig.left.pan, rig.right.pan), torn)
    encoders, encoders_warnings = read_encoders(
        named["encoders"], arm.dof, torn, (arm.lower, arm.upper), frames
    )
    left, right = open_images(named["left"]), open_images(named["right"])
    frames, sides, length_warnings = _common_length(named["frames"], frames, (left, right), torn)
    files = {getattr(table, key): file for key, file in named.items()}
    pending = path.parent / PENDING
    if torn and pending.exists():
        files[PENDING] = pending
    return {
        **session_folder.recording_fields(path, table, arm, timed=frames.timed),
        "rig": rig,
        "frames": frames,
        "encoders": encoders,
        "inputs": session_folder.file_digests(path, table.robot, files),
        "warnings": (*warnings, *frames_warnings, *encoders_warnings, *length_warnings),
        "left": sides[0],
        "right": sides[1],
    }


def _warn_mismatch(folder: Path, rig: Rig, marker: Marker) -> list[str]:
    """Warn of a rig and a marker that do not belong together."""
    notes = []
    if rig.registration != marker.registration:
        notes.append(
            f"{folder}: rig.toml and marker.toml carry different registrations, "
            f"{rig.registration or 'none'} and {marker.registration or 'none'}. "
            "Use the two files that one registration wrote."
        )
    stated = rig.covariance.parameters if rig.covariance else ()
    leds = {name.split(".", 1)[1].rsplit(".", 1)[0] for name in stated if name.startswith("led.")}
    notes += [
        f'{folder}: marker.toml has no LED "{name}", which the covariance in rig.toml names.'
        for name in sorted(leds.difference(marker.names))
    ]
    return [one_line(note) for note in notes]


def _common_length(
    path: Path, frames: FrameSeries, sides: tuple[Images, Images], torn: bool
) -> tuple[FrameSeries, tuple[Images, Images], list[str]]:
    """Compare the streams: of one length in a closed session, cut to the shortest if torn."""
    counts = [side.count(torn) for side in sides]
    if not torn:
        for side, count in zip(sides, counts, strict=True):
            if count != len(frames):
                expected = f"{path.name} has {len(frames)} rows"
                remedy = 'Copy the session again, or write `recording = "open"` if it was cut off.'
                raise InputError(side.path, f"has {count} images", expected, remedy)
        return frames, sides, []
    lengths = f"{len(frames)} rows, {counts[0]} left and {counts[1]} right images"
    whole = take_rows(frames, slice(min(len(frames), *counts)))
    frames, sides, pending = append_unfinished(path.parent, whole, sides)
    if not len(frames):
        remedy = "Record it again."
        raise InputError(path.parent, "was cut off before the first whole pair", "", remedy)
    lengths += f", {pending} pairs in {PENDING}" if pending else ""
    warning = (
        f"{path.parent}: the recording was cut off ({lengths}); {len(frames)} pairs are measured."
    )
    return frames, sides, [one_line(warning)]
