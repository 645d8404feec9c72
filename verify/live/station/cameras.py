"""A station's cameras and turning bases alone: what a calibration needs before there is a rig."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import msgspec

from verify.core.fiducials import Board
from verify.devices.cameras.capture import open_camera
from verify.devices.protocols import CameraDevice, CameraSettings, PanDevice
from verify.errors import InputError
from verify.io.toml import decode, one_of
from verify.live.station import devices
from verify.live.station.file import SIM, check_camera, check_sim, check_sources
from verify.live.station.keys import (
    SimSettings,
    StationCameraTable,
    StationEncodersTable,
    StationTable,
)

UNKNOWN_SIZE = (0, 0)  # stands where a rig would say for which one it is calibrated


class CamerasTable(StationTable, kw_only=True):
    """A station file of which only cameras and bases are asked for; the rest may be missing."""

    robot: str = ""
    rig: str = ""
    marker: str = ""
    encoders: StationEncodersTable = msgspec.field(
        default_factory=lambda: StationEncodersTable(driver="")
    )


class SimulatedCameras(Protocol):
    """Simulated cameras that see a board carried about."""

    @property
    def board(self) -> Board:
        """The board that is carried."""
        ...

    def camera(self, side: int, settings: CameraSettings) -> CameraDevice:
        """Open the left (0) or right (1) camera."""
        ...

    def pan(self) -> PanDevice:
        """Open the turning bases."""
        ...


SimulateCameras = Callable[[SimSettings, bool], SimulatedCameras]  # True: the bases are turned


@dataclass(frozen=True, slots=True)
class StationCameras:
    """Two cameras and their bases; devices are opened when they are asked for."""

    path: Path
    name: str
    board: Board | None  # the simulated one
    warnings: tuple[str, ...]
    open_cameras: Callable[[], tuple[CameraDevice, CameraDevice]]  # left, right
    open_pan: Callable[[], PanDevice | None]  # None: fixed bases


def open_station_cameras(path: str | Path, simulate: SimulateCameras) -> StationCameras:
    """Read a station file for its cameras and bases; no device is opened yet.

    Neither robot, rig, marker nor encoders need be there, and none is looked at.

    Args:
        path: the file.
        simulate: makes the simulated cameras, where the file asks for them.

    Raises:
        InputError: one line that names the file, the place in it, what stands there, what should,
            and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, CamerasTable)
    for side in ("left", "right"):
        check_camera(path, side, getattr(table, side))
    check_sources(path, table)
    one_of(path, "pan.driver", table.pan.driver, tuple(devices.PAN_KEYS))
    check_sim(path, table)
    sim = _make_simulated_cameras(path, table, simulate) if table.left.source == SIM else None
    if table.pan.driver != SIM and (pan := devices.open_pan(path, table.pan)) is not None:
        pan.close()  # wrong settings are found now: a driver opens its port later
    return StationCameras(
        path,
        table.description or path.stem,
        None if sim is None else sim.board,
        warnings,
        partial(_open_cameras, path, table, sim),
        partial(_open_pan, path, table, sim),
    )


def _make_simulated_cameras(
    path: Path, table: StationTable, simulate: SimulateCameras
) -> SimulatedCameras:
    is_file = Path(table.sim.scenario).suffix == ".toml"
    scenario = str(path.parent / table.sim.scenario) if is_file else table.sim.scenario
    try:
        return simulate(SimSettings(scenario, table.sim.speed), table.pan.driver == SIM)
    except InputError as error:
        found = f"{error.place}: {error.found}"
        place = f"{path}, sim.scenario"
        raise InputError(place, found, error.expected, error.remedy) from error


def _open_cameras(
    path: Path, table: StationTable, sim: SimulatedCameras | None
) -> tuple[CameraDevice, CameraDevice]:
    left, right = (_camera_settings(path, part) for part in (table.left, table.right))
    if sim is not None:
        return sim.camera(0, left), sim.camera(1, right)
    return open_camera(left), open_camera(right)


def _camera_settings(path: Path, table: StationCameraTable) -> CameraSettings:
    """What a camera is asked for; without a rig its own size is as good as any."""
    return replace(devices.camera_settings(path, table, UNKNOWN_SIZE), size=table.size)


def _open_pan(path: Path, table: StationTable, sim: SimulatedCameras | None) -> PanDevice | None:
    if sim is not None and table.pan.driver == SIM:
        return sim.pan()
    return devices.open_pan(path, table.pan)
