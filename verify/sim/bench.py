"""The hardware of a simulated session: two cameras on turning bases, an arm's base, LEDs.

Written without verify.rig and verify.marker on purpose: poses are composed with 4x4 matrices
here, and cv2.projectPoints projects. A mistake shared with the measurement would prove nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from verify.records import Array
from verify.sim.scenario import CameraTable, Scenario


def rigid(rotation_vector: Array, position: Array) -> Array:
    """Compose a (4, 4) pose from a rotation vector, rad, and a position, m."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = cv2.Rodrigues(np.asarray(rotation_vector, dtype=float))[0]
    a_T_b[:3, 3] = position
    return a_T_b


@dataclass(frozen=True, slots=True)
class SimulatedCamera:
    """A camera on a turning base, as rig.toml describes one."""

    matrix: Array  # (3, 3), px
    distortion: Array  # (5,), k1, k2, p1, p2, k3
    pan_center: Array  # (3,), m, rig frame
    pan_axis: Array  # (3,), unit vector, rig frame
    pan_zero: float  # rad
    turntable_T_camera: Array  # (4, 4)
    line_time: float  # s a row
    exposure: float  # s
    image_size: tuple[int, int]  # width, height, px

    def rig_T_camera(self, pan: float) -> Array:
        """Place the camera for its base's true angle, rad; (4, 4)."""
        rig_T_turntable = rigid(self.pan_axis * (pan + self.pan_zero), self.pan_center)
        placed: Array = rig_T_turntable @ self.turntable_T_camera
        return placed

    def project(self, points_rig: Array, pan: float) -> Array:
        """Image of points in the rig frame: (..., 3) m to (..., 2) px, NaN where not in sight."""
        rig_T_camera = self.rig_T_camera(pan)
        rotation = rig_T_camera[:3, :3]
        points = (np.reshape(points_rig, (-1, 3)) - rig_T_camera[:3, 3]) @ rotation
        # Far outside the lens's field the distortion polynomial folds back into the picture.
        sane = points[:, 2] > 0.01  # m: nothing is that close to a lens
        tangent = np.hypot(points[:, 0], points[:, 1]) / np.where(sane, points[:, 2], 1.0)
        sane &= tangent < 1.3 * self._corner_tangent()  # 1.3: room for barrel distortion
        pixels = np.full((len(points), 2), np.nan)
        if np.any(sane):
            seen, _ = cv2.projectPoints(
                points[sane], np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
            pixels[sane] = seen[:, 0]
        return np.reshape(pixels, (*np.shape(points_rig)[:-1], 2))

    def _corner_tangent(self) -> float:
        width, height = self.image_size
        x = max(self.matrix[0, 2], width - self.matrix[0, 2]) / self.matrix[0, 0]
        y = max(self.matrix[1, 2], height - self.matrix[1, 2]) / self.matrix[1, 1]
        return float(np.hypot(x, y))


@dataclass(frozen=True, slots=True)
class Bench:
    """What a calibration describes; one is what the user believes, another is how it truly is."""

    left: SimulatedCamera
    right: SimulatedCamera
    rig_T_base: Array  # (4, 4)
    leds: Array  # (n, 3), m, flange frame

    @property
    def cameras(self) -> tuple[SimulatedCamera, SimulatedCamera]:
        """Left, right."""
        return self.left, self.right


def build_camera(table: CameraTable, image_size: tuple[int, int], x: float) -> SimulatedCamera:
    """Build one camera whose pan centre lies at (x, 0, 0) of the rig, m."""
    fx, fy = table.focal_px
    cx, cy = table.principal_point_px
    axis = np.asarray(table.pan_axis, dtype=float)
    return SimulatedCamera(
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.asarray(table.distortion, dtype=float),
        pan_center=np.array([x, 0.0, 0.0]),
        pan_axis=axis / np.linalg.norm(axis),
        pan_zero=float(np.radians(table.pan_zero_deg)),
        turntable_T_camera=rigid(
            np.radians(table.mount_rotation_deg), np.asarray(table.mount_offset_mm) / 1000
        ),
        line_time=table.line_time_s,
        exposure=table.exposure_s,
        image_size=image_size,
    )


def build_bench(scenario: Scenario, rig_T_base: Array) -> Bench:
    """Build what the scenario's tables say, with the robot's base where it was placed."""
    rig = scenario.rig
    half = rig.baseline_mm / 2000
    return Bench(
        left=build_camera(rig.left, rig.image_size, -half),
        right=build_camera(rig.right, rig.image_size, half),
        rig_T_base=rig_T_base,
        leds=np.array([led.position_mm for led in scenario.marker.led], dtype=float) / 1000,
    )
