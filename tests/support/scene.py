"""A rig, a marker and true poses for tests of the chain; pixels by OpenCV, not our code."""

from dataclasses import replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from verify.core.fiducials import Marker
from verify.core.records import Array, Sighting
from verify.core.rig import Camera, Rig

LEDS = np.array([[62.0, 4.0, 18.0], [-48.0, 38.0, 12.0], [-22.0, -52.0, 26.0], [30.0, 55.0, 34.0]])


def make_rig(baseline: float = 0.17, pan: float = 7.5) -> Rig:
    sides = []
    for sign in (-1, 1):
        k = np.array([[1012.4, 0, 640 + 6 * sign], [0, 1011.1, 355.2], [0, 0, 1.0]])
        mount = np.eye(4)
        mount[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.015 * sign]).as_matrix()
        mount[:3, 3] = [0.004, -0.003, 0.012]
        axis = np.array([0.02, 1.0, -0.01 * sign])
        sides.append(
            Camera(
                matrix=k,
                distortion=np.array([-0.085, 0.06, 0.0006, -0.0004, 0.001]),
                pan_center=np.array([sign * baseline / 2, 0.001 * sign, 0.002]),
                pan_axis=axis / np.linalg.norm(axis),
                pan_zero=0.003 * sign,
                mount=mount,
                pan=-sign * np.deg2rad(pan),
            )
        )
    rig_T_base = np.eye(4)
    rig_T_base[:3, :3] = Rotation.from_rotvec([1.3, 0.4, -0.9]).as_matrix()
    rig_T_base[:3, 3] = [0.1, 0.5, 1.1]
    return Rig((1280, 720), sides[0], sides[1], rig_T_base)


def make_marker(count: int = 4, **stated: object) -> Marker:
    return Marker(
        names=tuple("ABCDEF"[:count]),
        leds=LEDS[:count] * 1e-3,
        colours=("white",) * count,
        led_diameter=0.005,
        **stated,  # type: ignore[arg-type]  # keyword fields of the dataclass
    )


def facing(x: float = 0.0, y: float = 0.0, z: float = 0.6) -> Array:
    """A flange that looks back at the cameras, (4, 4)."""
    pose = np.eye(4)
    look = Rotation.from_euler("yx", [180 + 8, 12], degrees=True)
    pose[:3, :3] = (Rotation.from_rotvec([0.1, 0.2, 0.3]) * look).as_matrix()
    pose[:3, 3] = [x, y, z]
    return pose


def project(camera: Camera, pan: float, points_rig: Array) -> Array:
    """Pixels by OpenCV, from matrices composed here: Trans(c) Rot(axis, b) Mount."""
    angle = pan + camera.pan_zero
    turn = cv2.Rodrigues(camera.pan_axis * angle)[0]
    rotation = turn @ camera.mount[:3, :3]
    centre = camera.pan_center + turn @ camera.mount[:3, 3]
    rvec = cv2.Rodrigues(rotation.T)[0]
    pixels, _ = cv2.projectPoints(
        points_rig.reshape(-1, 1, 3), rvec, -rotation.T @ centre, camera.matrix, camera.distortion
    )
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


def sighting(leds: list[int], centre: Array, sigma: float, t: float, pan: float) -> Sighting:
    """Spots at centres (n, 2) known to `sigma` px, at instant t, s, and base angle pan, rad."""
    n = len(centre)
    return Sighting(
        led=np.array(leds, dtype=np.int64),
        centre=centre,
        covariance=np.tile(np.eye(2) * sigma**2, (n, 1, 1)),
        t=t,
        pan=pan,
        peak=np.full(n, 200.0),
        velocity=np.zeros((n, 2)),
        lever=np.zeros((n, 3)),
    )


def sight(
    rig: Rig,
    marker: Marker,
    pose: Array,
    sigma: float,
    rng: np.random.Generator | None = None,
    leds: tuple[list[int], list[int]] | None = None,
) -> tuple[Sighting, Sighting]:
    """What both cameras see of the marker, with white noise of `sigma` px if rng is given."""
    sides = []
    for side, camera in enumerate((rig.left, rig.right)):
        index = list(range(len(marker))) if leds is None else leds[side]
        points = marker.leds[index] @ pose[:3, :3].T + pose[:3, 3]
        centre = project(camera, camera.pan, points)
        if rng is not None:
            centre = centre + rng.normal(0, sigma, centre.shape)
        sides.append(sighting(index, centre, sigma, 0.0, camera.pan))
    return sides[0], sides[1]


def off_axis(camera: Camera) -> Camera:
    """The camera with its optical centre off its base's axis."""
    mount = camera.mount.copy()
    mount[:3, 3] = [0.03, 0.05, -0.04]
    return replace(camera, mount=mount)


def turned(rotation: Array, axis: str, angle: float) -> Array:
    vector = np.eye(3)["xyz".index(axis)] * angle
    return Rotation.from_rotvec(vector).as_matrix() @ rotation


def move_camera(camera: Camera, key: str, step: float) -> Camera:
    lens = ("k1", "k2", "p1", "p2", "k3")
    if key in lens:
        return replace(camera, distortion=camera.distortion + step * np.eye(5)[lens.index(key)])
    places = {"fx_px": (0, 0), "fy_px": (1, 1), "cx_px": (0, 2), "cy_px": (1, 2)}
    if key in places:
        matrix = camera.matrix.copy()
        matrix[places[key]] += step
        return replace(camera, matrix=matrix)
    if key == "pan_zero_deg":
        return replace(camera, pan_zero=camera.pan_zero + step)
    if key.startswith("pan_center"):
        return replace(
            camera, pan_center=camera.pan_center + step * np.eye(3)["xyz".index(key[11])]
        )
    if key.startswith("pan_axis"):
        turn = turned(np.eye(3), key[10], step)
        return replace(camera, pan_axis=turn @ camera.pan_axis)
    mount = camera.mount.copy()
    if key.startswith("mount_r"):
        mount[:3, :3] = turned(mount[:3, :3], key[7], step)
    else:
        mount[:3, 3] += step * np.eye(3)["xyz".index(key[6])]
    return replace(camera, mount=mount)
