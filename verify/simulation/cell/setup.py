"""The simulated cell's fixed parts: arm, grab.toml, calibrated cameras, LEDs on the flange."""

from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

import robots
from robots.transforms import invert
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Camera, Covariance, Rig
from verify.grasping import cell as grasping_cell
from verify.grasping.cell import Cell
from verify.grasping.planning.plan import GraspPlanner, planner_with_cameras

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

    planner: GraspPlanner
    rig: Rig
    marker: Marker

    @property
    def cell(self) -> Cell:
        """What grab.toml says."""
        return self.planner.cell

    @property
    def home(self) -> Array:
        """Where the arm stands at first, (n,), rad."""
        home = self.cell.moving.home
        assert home is not None  # cell.toml states it
        return home


@cache
def cell_setup(size: tuple[int, int] = FULL_SIZE, *, turning: bool = False) -> CellSetup:
    """Put the cell together.

    Args:
        size: of the pictures, px.
        turning: the cameras stand on bases that turn.
    """
    arm = robots.load(ROBOT)
    file = resources.files("verify.simulation") / "cell.toml"
    with resources.as_file(file) as path:
        cell, _ = grasping_cell.read(Path(path), arm.dof)
    rig = _rig(size, PAN_UNCERTAINTY if turning else None)
    return CellSetup(planner_with_cameras(arm, cell, rig, turning=turning), rig, _marker())


def _rig(size: tuple[int, int], pan_uncertainty: float | None) -> Rig:
    """Two cameras before the robot that look down at the table; the rig's z is where they aim."""
    z = (AIM_POINT - RIG_POSITION) / np.linalg.norm(AIM_POINT - RIG_POSITION)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    base_T_rig = np.eye(4)
    base_T_rig[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    base_T_rig[:3, 3] = RIG_POSITION
    toe_in = float(np.arctan2(BASELINE / 2, np.linalg.norm(AIM_POINT - RIG_POSITION)))
    left, right = (
        replace(_camera(size, sign, -sign * toe_in), pan_standard_uncertainty=pan_uncertainty)
        for sign in (-1, 1)
    )
    named = RIG_UNCERTAINTY
    covariance = Covariance(tuple(named), np.array(list(named.values())), np.eye(len(named)))
    return Rig(size, left, right, invert(base_T_rig), covariance=covariance)


def _camera(size: tuple[int, int], sign: int, pan: float) -> Camera:
    width, height = size
    focal = FOCAL_RATIO * width
    matrix = [[focal, 0, (width - 1) / 2 + 3 * sign], [0, focal, (height - 1) / 2], [0, 0, 1]]
    return Camera(
        matrix=np.array(matrix, dtype=float),
        distortion=np.array([-0.06, 0.03, 0.0004, -0.0003, 0.0]),
        pan_center=np.array([sign * BASELINE / 2, 0.0, 0.0]),
        pan_axis=np.array([0.0, 1.0, 0.0]),
        pan_zero=0.0,
        mount=np.eye(4),
        pan=pan,
    )


def _marker() -> Marker:
    """Twelve LEDs on a collar about the palm: each turn of the hand shows some."""
    angles = np.deg2rad(LED_ANGLES_DEG)
    leds = np.stack([LED_RING * np.cos(angles), LED_RING * np.sin(angles), LED_HEIGHTS], axis=1)
    return Marker(
        tuple("ABCDEFGHIJKL"), leds, ("white",) * 12, led_diameter=LED_DIAMETER, source="jig"
    )
