"""A rig and a marker with stated uncertainties, and true ones drawn about them."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from tests.support.motions import ARM, HOME
from tests.support.scene import facing, make_marker, make_rig
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Covariance, Rig

SPOT_SIGMA = 0.03  # px
CAMERAS = [f"{side}.{k}_px" for side in ("left", "right") for k in ("fx", "fy", "cx", "cy")]
TURN = [f"right.mount_r{axis}_deg" for axis in "xyz"]
BASE = [f"robot_base.{axis}_mm" for axis in "xyz"] + [f"robot_base.r{axis}_deg" for axis in "xyz"]
SIGMA = np.array([0.3] * 8 + [0.01] * 3 + [0.1] * 3 + [0.02] * 3)  # in the units of the names


def believed(*, doubts: bool) -> tuple[Rig, Marker]:
    """What the files state: a rig before the arm, a marker of four LEDs."""
    rig = make_rig()
    home = robots.forward(ARM, HOME[None])[0]
    rig = replace(rig, rig_T_base=facing() @ np.linalg.inv(home))
    if not doubts:
        return rig, make_marker()
    names = (*CAMERAS, *TURN, *BASE)
    correlation = random_correlation(np.random.default_rng(0), len(names), len(names) + 20)
    stated_rig = replace(rig, covariance=Covariance(names, SIGMA, correlation))
    body = np.array([3e-5] * 3 + [np.deg2rad(0.02)] * 3)
    marker = make_marker(
        source="jig",
        body_standard_uncertainty=body,
        led_standard_uncertainty=2e-5,
        centre_shift_standard_uncertainty=1e-5,
    )
    return stated_rig, marker


def random_correlation(rng: np.random.Generator, size: int, rank: int) -> Array:
    mixed = rng.normal(size=(size, rank))
    spread = mixed @ mixed.T
    sigma = np.sqrt(np.diag(spread))
    correlation: Array = spread / np.outer(sigma, sigma)
    return correlation


def drawn(rig: Rig, marker: Marker, rng: np.random.Generator) -> tuple[Rig, Marker]:
    """One true world about what is stated."""
    doubt = rig.covariance
    if doubt is None or marker.body_standard_uncertainty is None:
        return rig, marker
    root = np.linalg.cholesky(doubt.correlation)
    draw = doubt.standard_uncertainty * (root @ rng.normal(size=len(root)))
    cameras = []
    for camera, (fx, fy, cx, cy) in zip((rig.left, rig.right), draw[:8].reshape(2, 4), strict=True):
        change = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
        cameras.append(replace(camera, matrix=camera.matrix + change))
    mount, base = rig.right.mount.copy(), rig.rig_T_base.copy()
    mount[:3, :3] = turned(np.deg2rad(draw[8:11])) @ mount[:3, :3]
    base[:3, 3] += draw[11:14] * 1e-3
    base[:3, :3] = turned(np.deg2rad(draw[14:17])) @ base[:3, :3]
    body = marker.body_standard_uncertainty * rng.normal(size=6)
    leds = marker.leds @ turned(body[3:]).T + body[:3]
    for sigma in (marker.led_standard_uncertainty, marker.centre_shift_standard_uncertainty):
        leds = leds + (sigma or 0.0) * rng.normal(size=leds.shape)
    right = replace(cameras[1], mount=mount)
    return replace(rig, left=cameras[0], right=right, rig_T_base=base), replace(marker, leds=leds)


def turned(vector: Array) -> Array:
    matrix: Array = Rotation.from_rotvec(vector).as_matrix()
    return matrix
