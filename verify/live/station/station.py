"""A station: the robot, the calibrated cameras, and the devices that one file names."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import msgspec

import robots
from verify.core.fiducials import Marker
from verify.core.rig import Rig
from verify.devices.cameras.capture import is_file
from verify.devices.cameras.replay import DEFAULT_RATE
from verify.devices.protocols import CameraDevice, EncoderDevice, PanDevice
from verify.errors import InputError, one_line
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.files import read_bytes, restated
from verify.io.session import keys
from verify.io.session.folder import ROBOT_FILES
from verify.io.session.keys import Tolerance
from verify.io.toml import key_error
from verify.live.protocols import MonitoredRobot
from verify.live.recording.recorder import MAX_LAG, WRITE_TIMEOUT, SessionRecorder
from verify.live.recording.session import SessionFacts
from verify.live.station import devices, file
from verify.live.station.file import SIM
from verify.live.station.keys import (
    AlarmTable,
    SimSettings,
    Simulate,
    SimulatedHardware,
    StationTable,
)

T = TypeVar("T")


@runtime_checkable
class PanDrive(PanDevice, Protocol):
    """Bases that can be turned: what `open_pan` gives where they follow."""

    def turn_to(self, left: float, right: float) -> bool:
        """Order both bases to angles, rad, as read; False if the line is down."""


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """Where recordings go."""

    folder: Path
    name: str  # of a recording's folder, for strftime


@dataclass(frozen=True, slots=True)
class RecordingStation:
    """Everything that `verify record` needs; devices are opened when they are asked for."""

    path: Path
    name: str
    arm: robots.Arm
    robot: str  # as the file names it
    rig: Rig | None  # None: the cameras are not calibrated yet; its base may be missing
    recording: RecordingSettings
    files: bool  # the cameras are files, whose pictures can wait
    warnings: tuple[str, ...]
    open_cameras: Callable[[], tuple[CameraDevice, CameraDevice]]  # left, right
    open_encoders: Callable[[], EncoderDevice]
    open_pan: Callable[[], PanDevice | None]  # None: fixed bases, which stand as the rig says
    facts: SessionFacts  # what a recording's session.toml says

    def open_recorder(
        self, write_timeout: float = WRITE_TIMEOUT, max_lag: float = MAX_LAG
    ) -> SessionRecorder:
        """Begin to record; the session's folder is made with the first pair."""
        folder, name = self.recording.folder, self.recording.name
        return SessionRecorder(
            folder, name, self.facts, write_timeout=write_timeout, max_lag=max_lag
        )


@dataclass(frozen=True, slots=True)
class Station(RecordingStation):
    """Everything that `verify run` needs."""

    rig: Rig
    watched: MonitoredRobot
    tolerance: Tolerance | None  # None: no verdict is asked for
    alarm: AlarmTable
    rate: float  # Hz, pairs: of the slower camera, as asked for
    follow: bool  # the bases turn to keep the LEDs in view; open_pan gives a PanDrive then


class RecordingStationTable(StationTable, kw_only=True):
    """A station file whose cameras need not be calibrated, nor its robot registered."""

    rig: str = ""
    marker: str = ""


def open_station(path: str | Path, simulate: Simulate) -> Station:
    """Read a station file and all that it names; no device is opened yet.

    Raises:
        InputError: one line that names the file, the place in it, what stands there, what should,
            and what to do.
    """
    path = Path(path)
    table, warnings = file.read(path, StationTable)
    sim = _simulation(path, table, simulate)
    arm = _arm(path, table, sim)
    rig, rig_warnings = _rig(path, table, sim)
    marker, marker_warnings = _marker(path, table, sim)
    notes = (*warnings, *rig_warnings, *marker_warnings)
    resolution = keys.to_radians(devices.resolution_deg(table.encoders))
    time_uncertainty = table.encoders.time_standard_uncertainty_s
    return Station(
        **_recording_fields(path, table, arm, sim, rig.image_size, notes),
        rig=rig,
        watched=MonitoredRobot(arm, rig, marker, table.clock, resolution, time_uncertainty),
        tolerance=keys.tolerance(path, table.tolerance, arm.dof),
        alarm=table.alarm,
        rate=min(table.left.rate_hz or DEFAULT_RATE, table.right.rate_hz or DEFAULT_RATE),
        follow=table.pan.follow,
    )


def open_recording_station(path: str | Path, simulate: Simulate) -> RecordingStation:
    """Read a station file to record by: `rig` and `marker` may be missing, and are then not known.

    A rig may lack the robot's base. Bases are read and never turned. Raises InputError as
    `open_station` does.
    """
    path = Path(path)
    table, warnings = file.read(path, RecordingStationTable)
    sim = _simulation(path, table, simulate)
    arm = _arm(path, table, sim)
    keys.tolerance(path, table.tolerance, arm.dof)
    if table.pan.follow:
        table.pan.follow = False
        note = "bases are read while a session is recorded, not turned; it is left alone."
        warnings = (*warnings, one_line(f"{path}, pan.follow: {note}"))
    for key in ("rig", "marker"):
        if (name := getattr(table, key)) and name != SIM and not (path.parent / name).exists():
            expected = "a session is recorded without it too"
            found = f"names {name}, which does not exist"
            raise key_error(path, key, found, expected, "Put it there, or leave the key out.")
    rig: Rig | None = None
    if table.rig:
        rig, notes = _rig(path, table, sim, registered=False)
        warnings += notes
    if table.marker:
        warnings += _marker(path, table, sim)[1]
    size = None if rig is None else rig.image_size
    return RecordingStation(**_recording_fields(path, table, arm, sim, size, warnings), rig=rig)


def _recording_fields(
    path: Path,
    table: StationTable,
    arm: robots.Arm,
    sim: SimulatedHardware | None,
    size: tuple[int, int] | None,
    warnings: tuple[str, ...],
) -> dict[str, Any]:
    """Give the fields of a RecordingStation but its rig; `size`, px, is the rig's, where known."""
    if size is not None:
        _require_size(path, table, sim, size)
    slug = "".join(c if c.isalnum() or c in "-_" else "_" for c in arm.name)
    left = devices.camera_settings(path, table.left, size)
    right = devices.camera_settings(path, table.right, size)
    # wrong settings are found now, not when the run begins: drivers open their ports later
    if table.encoders.driver != SIM:
        devices.open_encoders(path, table.encoders, arm.dof, sim).close()
    devices.check_pan(path, table.pan)
    return {
        "path": path,
        "name": table.description or path.stem,
        "arm": arm,
        "robot": table.robot,
        "recording": RecordingSettings(
            path.parent / table.recording.folder, table.recording.name.replace("{robot}", slug)
        ),
        "files": all(c.source != SIM and is_file(c.source) for c in (table.left, table.right)),
        "warnings": warnings,
        "open_cameras": partial(devices.open_cameras, left, right, sim),
        "open_encoders": partial(devices.open_encoders, path, table.encoders, arm.dof, sim),
        "open_pan": partial(devices.open_pan, path, table.pan, sim),
        "facts": _session_facts(path, table, arm.dof, sim),
    }


def _require_size(
    path: Path, table: StationTable, sim: SimulatedHardware | None, size: tuple[int, int]
) -> None:
    """Refuse cameras of another size, px, than the rig's."""
    if table.left.source == SIM and sim is not None and sim.rig.image_size != size:
        found = "is for {} x {} px".format(*size)
        expected = "the simulated cameras have {} x {}".format(*sim.rig.image_size)
        raise key_error(path, "rig", found, expected, 'Write rig = "sim".')
    for side, camera in (("left", table.left), ("right", table.right)):
        if camera.size is not None and tuple(camera.size) != tuple(size):
            found = "is {} x {}".format(*camera.size)
            expected = "the rig is calibrated for {} x {}".format(*size)
            raise key_error(path, f"{side}.size", found, expected)


def _simulation(path: Path, table: StationTable, simulate: Simulate) -> SimulatedHardware | None:
    if SIM not in (table.left.source, table.encoders.driver):
        return None
    return make_simulation(path, table, simulate)


def make_simulation(path: Path, table: StationTable, simulate: Callable[[SimSettings], T]) -> T:
    """Make the simulated devices of [sim].

    Raises:
        InputError: as they say, by the file's key.
    """
    sim = table.sim
    if Path(sim.scenario).suffix == ".toml":
        sim = msgspec.structs.replace(sim, scenario=str(path.parent / sim.scenario))
    try:
        return simulate(sim)
    except InputError as error:
        if error.place.startswith("sim."):
            key, found = error.place, error.found
        else:
            key, found = "sim.scenario", f"{error.place}: {error.found}"
        raise InputError(f"{path}, {key}", found, error.expected, error.remedy) from error


def _arm(path: Path, table: StationTable, sim: SimulatedHardware | None) -> robots.Arm:
    if sim is not None and table.robot != sim.robot:
        expected = f'the simulated robot is "{sim.robot}"'
        raise key_error(path, "robot", f'is "{table.robot}"', expected)
    chain = table.robot_frames
    is_file = Path(table.robot).suffix in ROBOT_FILES
    named = str(path.parent / table.robot) if is_file else table.robot
    with restated(robots.RobotError, place=f"{path}, robot"):
        return robots.load(named, base=chain.base, tip=chain.tip)


def _rig(
    path: Path, table: StationTable, sim: SimulatedHardware | None, *, registered: bool = True
) -> tuple[Rig, tuple[str, ...]]:
    if sim is not None and table.rig == SIM:
        return _round_trip(sim.rig, io_rig.write, io_rig.read), ()
    return io_rig.read(path.parent / table.rig, registered=registered)


def _marker(
    path: Path, table: StationTable, sim: SimulatedHardware | None
) -> tuple[Marker, tuple[str, ...]]:
    if sim is not None and table.marker == SIM:
        return _round_trip(sim.marker, fiducials.write_marker, fiducials.read_marker), ()
    return fiducials.read_marker(path.parent / table.marker)


def _round_trip(
    thing: T, write: Callable[[Path, T], None], read: Callable[[Path], tuple[T, tuple[str, ...]]]
) -> T:
    """Give what a recording's file will say: numbers are rounded there, in the 15th digit.

    What is measured live must be measured again from the recording, but for rounding.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "written.toml"
        write(path, thing)
        return read(path)[0]


def _session_facts(
    path: Path, table: StationTable, joints: int, sim: SimulatedHardware | None
) -> SessionFacts:
    """What a recording of this station says of itself: copies of its files, and the tables."""
    robot: str = table.robot
    files: dict[str, bytes] = {}
    if Path(robot).suffix in ROBOT_FILES:
        data = read_bytes(path.parent / robot)
        robot = f"robot{Path(robot).suffix}"
        files[robot] = data
    for name, given in (("rig.toml", table.rig), ("marker.toml", table.marker)):
        if given and given != SIM:
            # the very bytes that this run reads: written again they end otherwise
            files[name] = read_bytes(path.parent / given)
    if sim is not None and table.rig == SIM:
        files["rig.toml"] = io_rig.encode(sim.rig)
    if sim is not None and table.marker == SIM:
        files["marker.toml"] = fiducials.encode_marker(sim.marker)
    stated = table.encoders.time_standard_uncertainty_s
    readings = {
        "resolution_deg": devices.resolution_deg(table.encoders),
        "time_standard_uncertainty_s": stated,
    }
    tables: dict[str, Any] = {"description": table.description or path.stem}
    for key, part in (
        ("clock", table.clock),
        ("encoder_readings", readings),
        ("tolerance", table.tolerance),
        ("environment", table.environment),
        ("certificate", table.certificate),
        ("robot_frames", table.robot_frames),
    ):
        entries = {k: v for k, v in (msgspec.to_builtins(part) or {}).items() if v is not None}
        if entries:
            tables[key] = entries
    turning = table.pan.driver != "fixed"
    return SessionFacts(robot, joints, files, tables, turning, stated is not None)
