"""How far the true world may lie from what rig.toml and marker.toml say: stated, and drawn."""

from dataclasses import dataclass, replace

import numpy as np

from verify.core.records import Array
from verify.core.rig import Camera
from verify.planning.proposal import FOCAL_CORRELATION
from verify.simulation.scenario import ScenarioUncertainty
from verify.simulation.world.bench import Bench, SimulatedCamera, rigid, transform


@dataclass(frozen=True, slots=True)
class TrueDeviation:
    """True less stated, in the units that the parameters' names in rig.toml carry."""

    camera: Array  # (2, 4), left and right: fx, fy, cx, cy, px
    turn: Array  # (3,), rad, of the right camera, on the left of its mount rotation
    base: Array  # (6,), m and rad, rig axes; the rotation on the left
    body: Array  # (6,), m and rad, flange axes
    leds: Array  # (n, 3), m, flange axes
    pan: Array  # (2,), rad, of bases that stand still


def stated_cameras(
    cameras: tuple[SimulatedCamera, SimulatedCamera], pan: Array, pan_deg: float
) -> tuple[Camera, Camera]:
    """Describe both cameras as rig.toml does, with pan (2,), rad, as read.

    `pan_deg`: standard uncertainty of a reading; 0: none is stated.
    """
    left, right = (
        Camera(
            matrix=camera.matrix,
            distortion=camera.distortion,
            pan_center=camera.pan_center,
            pan_axis=camera.pan_axis,
            pan_zero=camera.pan_zero,
            mount=camera.turntable_T_camera,
            pan=float(angle),
            pan_standard_uncertainty=float(np.radians(pan_deg)) or None,
            line_time=camera.line_time,
            exposure=camera.exposure or None,
        )
        for camera, angle in zip(cameras, pan, strict=True)
    )
    return left, right


def draw_departure(
    stated: ScenarioUncertainty, leds: int, rng: np.random.Generator
) -> TrueDeviation:
    """Draw one true world about what is stated; every number is drawn whatever is 0."""
    normal = rng.standard_normal
    focal = np.array([[1.0, 0.0], [FOCAL_CORRELATION, np.sqrt(1 - FOCAL_CORRELATION**2)]])
    lens = np.concatenate(
        [stated.focal_px * normal((2, 2)) @ focal.T, stated.principal_point_px * normal((2, 2))], 1
    )
    return TrueDeviation(
        camera=lens,
        turn=np.radians(stated.camera_rotation_deg) * normal(3),
        base=_twist(stated.base_position_mm, stated.base_rotation_deg, normal(6)),
        body=_twist(stated.led_body_mm, stated.led_body_deg, normal(6)),
        leds=stated.led_mm / 1000 * normal((leds, 3)),
        pan=np.radians(stated.pan_deg) * normal(2),
    )


def apply_departure(bench: Bench, by: TrueDeviation) -> Bench:
    """Move a bench from what is stated to what is true (pans aside: they are readings)."""
    left, right = (replace(camera, matrix=camera.matrix.copy()) for camera in bench.cameras)
    for camera, change in zip((left, right), by.camera, strict=True):
        camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change  # fx, fy, cx, cy
    turned = right.turntable_T_camera.copy()
    turned[:3, :3] = rigid(by.turn, np.zeros(3))[:3, :3] @ turned[:3, :3]
    rig_T_base = bench.rig_T_base.copy()
    rig_T_base[:3, :3] = rigid(by.base[3:], np.zeros(3))[:3, :3] @ rig_T_base[:3, :3]
    rig_T_base[:3, 3] += by.base[:3]
    leds = transform(rigid(by.body[3:], by.body[:3]), bench.leds) + by.leds
    return Bench((left, replace(right, turntable_T_camera=turned)), rig_T_base, leds)


def _twist(length_mm: float, angle_deg: float, numbers: Array) -> Array:
    scale = np.repeat([length_mm / 1000, float(np.radians(angle_deg))], 3)
    return scale * numbers
