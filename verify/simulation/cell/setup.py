"""The simulated cell's fixed parts: arm, grab.toml, calibrated cameras, LEDs on the flange."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

import robots
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Camera, Covariance, Rig
from verify.grasping import cell as grasping_cell
from verify.grasping.cell import Cell
from verify.grasping.planning.workspace import Workspace, workspace_with_cameras
from verify.planning.proposal import level_camera, look_at

ROBOT = "rv_3sd_melfa"
FULL_SIZE, SMALL_SIZE = (1280, 720), (640, 360)  # px
FOCAL_RATIO = 1.05  # focal length over the picture's width
BASELINE = 0.36  # m
RIG_POSITION = np.array([1.15, 0.0, 0.62])  # m, base frame, midway between the cameras
AIM_POINT = np.array([0.44, 0.0, 0.08])  # m, where both look
RIG_UNCERTAINTY = {"robot_base.x_mm": 0.3, "robot_base.y_mm": 0.3, "robot_base.z_mm": 0.3}
PAN_UNCERTAINTY = 3e-5  # rad, of a turned base's reading
LED_RING, LED_DIAMETER = 0.052, 0.006  # m, radius; and diameter
# no two neighbours are like two others, or they would be taken for one another
LED_ANGLES_DEG = np.array([0, 35, 54, 93, 127, 146, 182, 203, 246, 268, 304, 325], dtype=float)
LED_HEIGHTS = np.array([42, 68, 50, 74, 45, 61, 77, 43, 71, 52, 40, 64]) * 1e-3  # m


@dataclass(frozen=True)
class CellSetup:
    """What is known of the simulated cell by those who work in it."""

    workspace: Workspace
    rig: Rig
    marker: Marker

    @property
    def cell(self) -> Cell:
        """What grab.toml says."""
        return self.workspace.cell

    @property
    def home(self) -> Array:
        """Where the arm stands at first, (n,), rad."""
        home = self.cell.moving.home
        assert home is not None  # cell.toml states it
        return home


@cache
def cell_setup(size: tuple[int, int] = FULL_SIZE, *, turning: bool = False) -> CellSetup:
    """Put the cell together."""
    arm = robots.load(ROBOT)
    cell, _ = grasping_cell.read(Path(__file__).parents[1] / "cell.toml", arm.dof)
    rig = _rig(size, PAN_UNCERTAINTY if turning else None)
    return CellSetup(workspace_with_cameras(arm, cell, rig, turning=turning), rig, _marker())


def _rig(size: tuple[int, int], pan_uncertainty: float | None) -> Rig:
    """Two cameras before the robot that look down at the table; the rig's z is where they aim."""
    toe_in = float(np.arctan2(BASELINE / 2, np.linalg.norm(AIM_POINT - RIG_POSITION)))
    left, right = (_camera(size, sign, -sign * toe_in, pan_uncertainty) for sign in (-1, 1))
    u = RIG_UNCERTAINTY
    covariance = Covariance(tuple(u), np.array(list(u.values())), np.eye(len(u)))
    return Rig(size, left, right, look_at(RIG_POSITION, AIM_POINT), covariance=covariance)


def _camera(size: tuple[int, int], sign: int, pan: float, pan_uncertainty: float | None) -> Camera:
    ideal = level_camera(size, FOCAL_RATIO * size[0], sign * BASELINE / 2, pan)
    return replace(
        ideal,
        matrix=ideal.matrix + np.array([[0, 0, 3 * sign], [0, 0, 0], [0, 0, 0]]),
        distortion=np.array([-0.06, 0.03, 0.0004, -0.0003, 0.0]),
        pan_standard_uncertainty=pan_uncertainty,
    )


def _marker() -> Marker:
    """Twelve LEDs on a collar about the palm: each turn of the hand shows some."""
    angles = np.deg2rad(LED_ANGLES_DEG)
    leds = np.stack([LED_RING * np.cos(angles), LED_RING * np.sin(angles), LED_HEIGHTS], axis=1)
    return Marker(
        tuple("ABCDEFGHIJKL"), leds, ("white",) * 12, led_diameter=LED_DIAMETER, source="jig"
    )
