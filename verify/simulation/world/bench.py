"""The hardware of a simulated session: two cameras on turning bases, the arm's base, LEDs.

The rig is placed so that every LED is in view in every pair. Poses are composed with 4x4 matrices
and cv2.projectPoints projects, without the code of verify.core.rig: a mistake shared with the
measurement would prove nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from verify.core.records import Array, Flags, rigid_transform
from verify.errors import InputError
from verify.planning.proposal import look_at, spread_directions
from verify.simulation.scenario import BoardRig, Scenario, ScenarioCamera, ScenarioPlacement


def rigid(rotation_vector: Array, position: Array) -> Array:
    """Compose a (4, 4) pose from a rotation vector, rad, and a position, m."""
    return rigid_transform(cv2.Rodrigues(np.asarray(rotation_vector, dtype=float))[0], position)


def rigid_from_table(rotation_deg: tuple[float, ...], position_mm: tuple[float, ...]) -> Array:
    """Compose a (4, 4) pose from a scenario's rotation vector, degrees, and position, mm."""
    return rigid(np.radians(rotation_deg), np.asarray(position_mm) / 1000)


def transform(a_T_b: Array, points_b: Array) -> Array:
    """Express points (..., 3), m, given in b in frame a."""
    return points_b @ a_T_b[:3, :3].T + a_T_b[:3, 3]


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
        return rig_T_turntable @ self.turntable_T_camera

    def project(self, points_rig: Array, pan: float) -> Array:
        """Image of points in the rig frame: (..., 3) m to (..., 2) px, NaN where not in sight."""
        rig_T_camera = self.rig_T_camera(pan)
        rotation = rig_T_camera[:3, :3]
        points = (np.reshape(points_rig, (-1, 3)) - rig_T_camera[:3, 3]) @ rotation
        # Far outside the lens's field the distortion polynomial folds back into the picture.
        sane = points[:, 2] > 0.01  # m: nothing is that close to a lens
        tangent = np.hypot(points[:, 0], points[:, 1]) / np.where(sane, points[:, 2], 1.0)
        middle, focal = self.matrix[:2, 2], np.diagonal(self.matrix)[:2]
        corner = np.hypot(*(np.maximum(middle, self.image_size - middle) / focal))
        sane &= tangent < 1.3 * corner  # 1.3: room for barrel distortion
        pixels = np.full((len(points), 2), np.nan)
        if np.any(sane):
            image, _ = cv2.projectPoints(
                points[sane], np.zeros(3), np.zeros(3), self.matrix, self.distortion
            )
            pixels[sane] = image[:, 0]
        return np.reshape(pixels, (*np.shape(points_rig)[:-1], 2))


@dataclass(frozen=True, slots=True)
class Bench:
    """What a calibration describes; one is what the user believes, another is how it truly is."""

    cameras: tuple[SimulatedCamera, SimulatedCamera]  # left, right
    rig_T_base: Array  # (4, 4)
    leds: Array  # (n, 3), m, flange frame


def build_cameras(rig: BoardRig) -> tuple[SimulatedCamera, SimulatedCamera]:
    """Build the left and right camera, whose pan centres lie on the rig's x axis."""
    half = rig.baseline_mm / 2000
    return (
        build_camera(rig.left, rig.image_size, -half),
        build_camera(rig.right, rig.image_size, half),
    )


def build_camera(table: ScenarioCamera, image_size: tuple[int, int], x: float) -> SimulatedCamera:
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
        turntable_T_camera=rigid_from_table(table.mount_rotation_deg, table.mount_offset_mm),
        line_time=table.line_time_s,
        exposure=table.exposure_s,
        image_size=image_size,
    )


def build_bench(scenario: Scenario, rig_T_base: Array) -> Bench:
    """Build what the scenario's tables say, with the robot's base where it was placed."""
    leds = np.array([led.position_mm for led in scenario.marker.led], dtype=float) / 1000
    return Bench(build_cameras(scenario.rig), rig_T_base, leds)


MARGIN_PX = 25.0  # from the edge to an LED's centre: a spot of 5 mm and its blur stay inside
MIN_COSINE = 0.5  # 60°: beyond it a flat LED is a sliver and a dome hides behind its holder
# of the wanted distance, where the view is too narrow
DISTANCE_FACTORS = (1.0, 1.1, 1.2, 1.35, 1.5)


def place_rig(scenario: Scenario, points: Array, normals: Array) -> tuple[Array, Array]:
    """Take the placement that the scenario's rig table asks for, or look for one.

    `points` (pairs, leds, 3), m, are the LEDs in the robot's base frame, which shine along
    `normals`. Returns rig_T_base (4, 4), and how the camera bases are turned in every pair,
    (pairs, 2), rad, as set: left, right.

    Raises:
        InputError: no direction shows every LED in every pair.
    """
    rig = scenario.rig
    if isinstance(rig.placement, ScenarioPlacement):
        placement = rig.placement
        rig_T_base = rigid_from_table(placement.base_rotation_deg, placement.base_position_mm)
        pan = np.tile(np.radians(placement.pan_deg), (len(points), 1))
        if rig.bases == "follow":
            pan = _pans(scenario, build_bench(scenario, rig_T_base), points)
        return rig_T_base, pan
    target: Array = points.reshape(-1, 3).mean(axis=0)
    for back in DISTANCE_FACTORS:
        eyes = target + (back * rig.distance_mm / 1000) * spread_directions()
        for eye in eyes[_rank_eyes(eyes, points, normals)]:
            rig_T_base = look_at(eye, target)
            bench = build_bench(scenario, rig_T_base)
            pan = _pans(scenario, bench, points)
            if _all_inside(bench, pan, points):
                return rig_T_base, pan
    raise InputError(
        "rig.placement",
        f"no place near {rig.distance_mm:g} mm shows every LED in every pair, at most 60° from "
        "where it shines",
        remedy="Make the motion smaller, the distance longer, or let the bases follow.",
    )


def _rank_eyes(eyes: Array, points: Array, normals: Array) -> Array:
    """Order the eyes (e, 3) that see every LED within 60°, the one that sees them best first."""
    toward = eyes[:, None, None] - points
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    worst = np.sum(toward * normals, axis=-1).min(axis=(1, 2))
    order = np.argsort(-worst, kind="stable")
    return np.asarray(order[worst[order] > MIN_COSINE])


def _pans(scenario: Scenario, bench: Bench, points: Array) -> Array:
    """Turn each base towards the LEDs' mean, of each pair or of all, in whole steps."""
    rig = scenario.rig
    means = transform(bench.rig_T_base, points).mean(axis=1)
    if rig.bases == "fixed":
        means = np.tile(means.mean(axis=0), (len(means), 1))
    step = np.radians(rig.pan_step_deg)
    pans = np.stack([_pan_towards(camera, means) for camera in bench.cameras], axis=1)
    return np.asarray(np.round(pans / step) * step)


def _pan_towards(camera: SimulatedCamera, targets: Array) -> Array:
    """Find the pan at which the optical axis passes the targets (n, 3) nearest, (n,) rad."""
    axis = camera.pan_axis
    ahead = camera.turntable_T_camera[:3, 2]

    def across(v: Array) -> Array:
        return v - (v @ axis)[..., None] * axis

    start, toward = across(ahead), across(targets - camera.pan_center)
    sine = np.cross(start, toward) @ axis
    return np.arctan2(sine, toward @ start) - camera.pan_zero


def _all_inside(bench: Bench, pan: Array, points: Array) -> bool:
    """Tell if both cameras have every LED well inside the picture in every pair."""
    in_rig = transform(bench.rig_T_base, points)
    for side, camera in enumerate(bench.cameras):
        turns, pairs = np.unique(pan[:, side], return_inverse=True)
        for i, turn in enumerate(turns):  # fixed bases: one projection of all pairs
            pixels = camera.project(in_rig[pairs == i], turn)
            if not inside(pixels, camera.image_size, MARGIN_PX).all():
                return False
    return True


def inside(pixels: Array, image_size: tuple[int, int], border_px: float) -> Flags:
    """Which of (..., 2) px lie in the picture, clear of its edge; NaN, out of sight, do not."""
    limit = np.array(image_size) - 1 - border_px
    return np.asarray(np.all((pixels > border_px) & (pixels < limit), axis=-1))
