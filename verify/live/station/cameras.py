"""A station's cameras and turning bases without robot and rig, as a calibration needs them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol

import msgspec

from verify.core.fiducials import Board
from verify.devices.protocols import CameraDevice, PanDevice
from verify.io.toml import decode
from verify.live.station import devices, keys
from verify.live.station.file import SIM, check_cameras
from verify.live.station.station import make_simulation


class CamerasTable(keys.StationTable, kw_only=True):
    """A station file of which only cameras and bases are asked for; the rest may be missing."""

    robot: str = ""
    rig: str = ""
    marker: str = ""
    encoders: keys.StationEncodersTable = msgspec.field(
        default_factory=lambda: keys.StationEncodersTable(driver="")
    )


class SimulatedCameras(keys.SimulatedDevices, Protocol):
    """Simulated cameras that see a board carried about."""

    @property
    def board(self) -> Board:
        """The board that is carried."""


SimulateCameras = Callable[[keys.SimSettings, bool], SimulatedCameras]  # True: the bases are turned


@dataclass(frozen=True, slots=True)
class StationCameras:
    """Two cameras and their bases; devices are opened when they are asked for."""

    name: str
    board: Board | None  # the simulated one
    warnings: tuple[str, ...]
    open_cameras: Callable[[], tuple[CameraDevice, CameraDevice]]  # left, right
    open_pan: Callable[[], PanDevice | None]  # None: fixed bases


def open_station_cameras(path: str | Path, simulate: SimulateCameras) -> StationCameras:
    """Read a station file for its cameras and bases; no device is opened yet.

    Neither robot, rig, marker nor encoders need be there, and none is looked at.

    Raises:
        InputError: one line that names the file, the place in it, what stands there, what should,
            and what to do.
    """
    path = Path(path)
    table, warnings = decode(path, CamerasTable)
    check_cameras(path, table)
    turning = table.pan.driver == SIM
    simulated = table.left.source == SIM
    sim = make_simulation(path, table, lambda s: simulate(s, turning)) if simulated else None
    devices.check_pan(path, table.pan)
    left = devices.camera_settings(path, table.left, None)
    right = devices.camera_settings(path, table.right, None)
    return StationCameras(
        table.description or path.stem,
        None if sim is None else sim.board,
        warnings,
        partial(devices.open_cameras, left, right, sim),
        partial(devices.open_pan, path, table.pan, sim),
    )
