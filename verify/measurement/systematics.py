"""Systematic errors: stated uncertainties of rig, base and LEDs, carried to the measured pose.

Model, first order, at fixed pictures, with a parameter's error d and the pose fit's gain G:

    error of base_T_flange = C d,   C = -G dz/dd   (cameras, LEDs: z are the predicted spots)
                                    C = -d(pose in base) / d(base in rig)   (robot base)
    covariance = C V C^T,   V from rig.toml and marker.toml

Parameter vector d, as named in the files, in SI units inside:

    name                                            meaning                         unit
    left|right.fx_px, fy_px, cx_px, cy_px           camera matrix                   px
    left|right.k1, k2, p1, p2, k3                   lens                            1
    left|right.pan_zero_deg                         zero of the pan scale           rad
    left|right.pan_axis_r[xyz]_deg, pan_center_*    axis of the base, rig axes      rad, m
    left|right.mount_[xyz]_mm, mount_r[xyz]_deg     camera on its turntable         m, rad
    robot_base.[xyz]_mm, r[xyz]_deg                 robot base, rig axes            m, rad
    body.[xyz]_mm, r[xyz]_deg                       LED body, flange axes           m, rad
    led.NAME.[xyz]_mm, centre.NAME.[xyz]_mm         LED, its apparent centre        m

A small rotation acts on the left, in the axes of the frame that holds it.
"""

import re
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from scipy.linalg import block_diag

from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, SIDES, Array, Measurement, Pose, Sighting
from verify.core.rig import Covariance, Rig
from verify.measurement.sensitivities import AXES, camera_derivatives, spot_derivatives
from verify.measurement.triangulation import triangulate

PAN_ANGLE, PAN_AXES = "pan angle", "pan axes"
PAN_READINGS = "left.pan_zero_deg", "right.pan_zero_deg"  # err as the zeros of their scales do
SOURCES = {
    "left": "rig",
    "right": "rig",
    "robot_base": "robot base",
    "body": "LED body",
    "led": "LED positions",
    "centre": "apparent LED centre",
}
UNITS = {"mm": 1e-3, "deg": np.pi / 180, "px": 1.0}
CAMERA_KEYS = re.compile(
    r"^(fx_px|fy_px|cx_px|cy_px|k1|k2|p1|p2|k3|pan_zero_deg|pan_axis_r[xyz]_deg"
    r"|(mount|pan_center)_[xyz]_mm|mount_r[xyz]_deg)$"
)


@dataclass(frozen=True, slots=True)
class Systematics:
    """The parameters whose uncertainty is stated, in SI units."""

    names: tuple[str, ...]
    sources: tuple[str, ...]  # which line of the budget each belongs to
    covariance: Array  # (p, p)
    pan: Array  # (2,), rad, standard uncertainty of each pan reading; nan where not stated
    uncounted: tuple[str, ...]  # sources that state no uncertainty and are taken as exact
    degrees_of_freedom: float = float("inf")
    unknown: tuple[str, ...] = field(default=())  # parameter names of no known form


def stated_systematics(rig: Rig, marker: Marker, turning: bool) -> Systematics:
    """Collect the uncertainties that rig.toml and marker.toml state; both are optional.

    `turning`: the bases turn, or stand elsewhere than where rig.toml was found, so that their
    readings and axes are a source at all.
    """
    names, blocks, unknown, degrees = _from_rig(rig, marker)
    placed = any(n.startswith("led.") for n in names)  # in the flange frame: body included
    for extra, sigma in _from_marker(marker, leds=not placed):
        names += extra
        blocks.append(np.diag(np.square(sigma)))
    pan = [
        np.nan if c.pan_standard_uncertainty is None else c.pan_standard_uncertainty
        for c in (rig.left, rig.right)
    ]
    return Systematics(
        names=tuple(names),
        sources=tuple(_source(n) for n in names),
        covariance=np.asarray(block_diag(*blocks), dtype=float).reshape(len(names), len(names)),
        pan=np.array(pan),
        uncounted=(
            *_unstated_names(names, placed),
            *[PAN_ANGLE] * bool(turning and np.isnan(pan).any()),
            *[PAN_AXES] * (turning and _states_cameras_alone(names)),
            "robot table",
        ),
        degrees_of_freedom=degrees,
        unknown=tuple(unknown),
    )


def _from_rig(rig: Rig, marker: Marker) -> tuple[list[str], list[Array], list[str], float]:
    stated = rig.covariance
    if stated is None:
        return [], [], [], float("inf")
    kept = [i for i, n in enumerate(stated.parameters) if _is_known(n, marker)]
    known = stated.take(kept)
    unknown = [n for n in stated.parameters if n not in known.parameters]
    degrees = stated.degrees_of_freedom or float("inf")
    return list(known.parameters), [covariance_in_si(known)], unknown, degrees


def covariance_in_si(covariance: Covariance) -> Array:
    """Full covariance matrix of the named parameters, (p, p), in SI units and pixels."""
    sigma = covariance.standard_uncertainty * np.array([unit(n) for n in covariance.parameters])
    return covariance.correlation * np.outer(sigma, sigma)


def unit(name: str) -> float:
    """SI units (or pixels, or one) in a unit of the parameter, by its name's suffix."""
    return UNITS.get(name.rsplit("_", 1)[-1], 1.0)


def _is_known(name: str, marker: Marker) -> bool:
    head, _, key = name.partition(".")
    if head in ("left", "right"):
        return CAMERA_KEYS.match(key) is not None
    if head == "robot_base":
        return key in POSE_NAMES
    led, _, axis = key.rpartition(".")
    return head == "led" and led in marker.names and axis in ("x_mm", "y_mm", "z_mm")


def _from_marker(marker: Marker, *, leds: bool) -> list[tuple[list[str], Array]]:
    """Parameters of the marker with their standard uncertainties; LEDs unless the rig has them."""
    groups = []
    if marker.body_standard_uncertainty is not None:
        groups.append(([f"body.{key}" for key in POSE_NAMES], marker.body_standard_uncertainty))
    sigmas = {
        "led": marker.led_standard_uncertainty if leds else None,
        "centre": marker.centre_shift_standard_uncertainty,
    }
    for head, sigma in sigmas.items():
        if sigma is not None:
            names = [f"{head}.{led}.{axis}_mm" for led in marker.names for axis in AXES]
            groups.append((names, np.full(len(names), sigma)))
    return groups


def _source(name: str) -> str:
    return SOURCES[name.partition(".")[0]]


def _states_cameras_alone(names: list[str]) -> bool:
    """Cameras, but no axis that their bases turn about: it was a choice, as no base turned."""
    sides = tuple(f"{side}." for side in SIDES)
    return any(n.startswith(sides) for n in names) and not any(".pan_axis_" in n for n in names)


def _unstated_names(names: list[str], placed: bool) -> list[str]:
    present = {_source(n) for n in names}
    missing = [source for source in dict.fromkeys(SOURCES.values()) if source not in present]
    if placed and "LED body" in missing:
        missing.remove("LED body")
    return missing


def sensitivities(
    parameters: Systematics, measurement: Measurement, rig: Rig, marker: Marker
) -> Array:
    """How the measured pose in the robot's base changes with each parameter; (6, p + 2).

    The last two columns are the left and the right pan reading. Twists in base axes at the
    flange, m and rad a SI unit of the parameter.
    """
    pose, left, right = measurement.pose, measurement.left, measurement.right
    if pose is None or left is None or right is None:
        raise ValueError("only a measured pair has sensitivities")
    base_R_rig = rig.rig_T_base[:3, :3].T
    gain = (base_R_rig @ pose.gain.reshape(2, 3, -1)).reshape(6, -1)
    names = (*parameters.names, *PAN_READINGS)
    columns = -gain @ pixel_sensitivities(names, measurement, rig, marker)
    places, axes = _base_columns(parameters.names)
    if places:
        columns[:, places] = by_base(rig, pose)[:, axes]
    return columns


@lru_cache(maxsize=4)
def _base_columns(names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Which parameters place the robot's base, and in which of the six directions."""
    places = [i for i, name in enumerate(names) if name.startswith("robot_base.")]
    return places, [POSE_NAMES.index(names[i].partition(".")[2]) for i in places]


def pixel_sensitivities(
    names: tuple[str, ...], measurement: Measurement, rig: Rig, marker: Marker
) -> Array:
    """How a pair's spots move with parameters, (2 s, p), px a SI unit; a robot base moves none."""
    pose, left, right = measurement.pose, measurement.left, measurement.right
    if pose is None or left is None or right is None:
        raise ValueError("only a measured pair has spots that a pose predicts")
    spots = pose.rig_T_flange, (left, right), pose.sensitivity
    moved = spot_derivatives(names, *spots, rig, marker)
    return moved.reshape(len(names), 2 * len(pose.sensitivity)).T


def spot_columns(
    parameters: Systematics,
    rig: Rig,
    marker: Marker,
    left: Sighting,
    right: Sighting,
    rig_T_flange: Array,
    by_point: Array,
) -> Array:
    """Columns of unit variance (2 s, p), px, left spots first, by the stated uncertainties.

    A robot base moves no spot. `by_point` (s, 2, 3), d px / d point in the rig.
    """
    names = tuple(n for n in parameters.names if not n.startswith("robot_base."))
    places = [parameters.names.index(n) for n in names]
    spread = covariance_root(parameters.covariance[np.ix_(places, places)])
    turning = [i for i in (0, 1) if parameters.pan[i] > 0]
    angles = [f"{('left', 'right')[i]}.pan_zero_deg" for i in turning]
    spots = rig_T_flange, (left, right), by_point
    moved = spot_derivatives((*names, *angles), *spots, rig, marker)
    moved = moved.reshape(-1, 2 * len(by_point)).T
    own = [moved[:, : len(names)] @ spread, moved[:, len(names) :] * parameters.pan[turning]]
    return np.concatenate(own, axis=1)


@lru_cache(maxsize=4)
def disparity_uncertainty(rig: Rig) -> float:
    """By how much a point's images may disagree, px: one standard uncertainty, as rig.toml states.

    Of the one direction of both images that no place of the point explains, for a point before the
    cameras that both see. 0 where nothing is stated.
    """
    half, cameras, stated = rig.image_size[0] / 10, (rig.left, rig.right), rig.covariance
    middle = [np.array(rig.image_size) / 2 + [by, 0.0] for by in (half, -half)]
    point, _ = triangulate(*cameras, rig.left.pan, rig.right.pan, middle[0], middle[1])
    if stated is None or not np.isfinite(point).all():
        return 0.0
    moved, by_point = np.zeros((4, len(stated.parameters))), np.zeros((4, 3))
    for rows, side, camera in zip((slice(0, 2), slice(2, 4)), SIDES, cameras, strict=True):
        camera_T_rig = camera.camera_T_rig(camera.pan)
        inside = camera_T_rig[:3] @ np.append(point, 1.0)
        turn, sight = camera_T_rig[:3, :3] / inside[2], inside[:2] / inside[2]
        by_point[rows] = camera.matrix[:2, :2] @ (turn[:2] - np.outer(sight, turn[2]))
        keys = [name.partition(".")[2] * name.startswith(side) for name in stated.parameters]
        own = [i for i, key in enumerate(keys) if CAMERA_KEYS.match(key)]
        spot = inside[None], point[None], by_point[None, rows]
        changes = camera_derivatives(tuple(keys[i] for i in own), camera, camera.pan, *spot)
        moved[rows, own] = changes[:, 0].T
    across = np.linalg.svd(by_point)[0][:, 3] @ moved
    return float(np.sqrt(across @ covariance_in_si(stated) @ across))


def covariance_root(covariance: Array) -> Array:
    """A matrix whose square is the covariance, (p, q), without the directions of no variance."""
    sigma = np.sqrt(np.diag(covariance))
    safe = np.where(sigma > 0, sigma, 1.0)  # metres beside pixels: scaled before the eigenvalues
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    some = values > 1e-12  # of a correlation matrix: rounding
    root: Array = sigma[:, None] * vectors[:, some] * np.sqrt(values[some])
    return root


def by_base(rig: Rig, pose: Pose) -> Array:
    """Change of the flange's pose in the base when the base's place in the rig changes, (6, 6)."""
    base_R_rig = rig.rig_T_base[:3, :3].T
    x, y, z = (pose.rig_T_flange[:3, 3] - rig.rig_T_base[:3, 3]).tolist()
    change = np.zeros((6, 6))  # by a shift along the rig's axes, and by a turn about them
    change[:3, :3] = change[3:, 3:] = base_R_rig
    change[:3, 3:] = base_R_rig @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return -change
