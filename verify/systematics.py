"""What does not average out: the stated uncertainties of rig, base and LEDs, and what they move.

A parameter's sensitivity is the derivative of the measured pose by the value in the file, at
fixed pictures. A small rotation acts on the left, in the axes of the frame that holds it
(docs/session.md): the rig's for the robot base and pan axis, the turntable's for a mount, the
flange's for the LED body.
"""

import re
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.linalg import block_diag

from verify.marker import Marker
from verify.records import Array, Measurement, Pose, Sighting
from verify.rig import Camera, Rig, distort

AXES = ("x", "y", "z")
BODY = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
LENS = ("k1", "k2", "p1", "p2", "k3")
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
    unknown: tuple[str, ...] = field(default=())  # parameter names that nobody here understands


def stated(rig: Rig, marker: Marker, turning: bool) -> Systematics:
    """Collect what rig.toml and marker.toml say of their own uncertainty.

    Args:
        rig: the rig with its optional covariance.
        marker: the LEDs with their optional uncertainties.
        turning: pan readings vary or carry an uncertainty, so that they are a source at all.
    """
    names, blocks, unknown, degrees = _from_rig(rig, marker)
    placed = any(n.startswith("led.") for n in names)  # in the flange frame: body included
    lists = [_body(marker), _leds(marker, names), _centres(marker)]
    for extra, sigma in lists:
        names += extra
        blocks.append(np.diag(np.square(sigma)) if extra else np.zeros((0, 0)))
    pan = [
        np.nan if c.pan_standard_uncertainty is None else c.pan_standard_uncertainty
        for c in (rig.left, rig.right)
    ]
    return Systematics(
        names=tuple(names),
        sources=tuple(_source(n) for n in names),
        covariance=np.asarray(block_diag(*blocks), dtype=float).reshape(len(names), len(names)),
        pan=np.array(pan),
        uncounted=_uncounted(names, placed, bool(turning and np.isnan(pan).any())),
        degrees_of_freedom=degrees,
        unknown=tuple(unknown),
    )


def _from_rig(rig: Rig, marker: Marker) -> tuple[list[str], list[Array], list[str], float]:
    given = rig.covariance
    if given is None:
        return [], [], [], float("inf")
    understood = [i for i, n in enumerate(given.parameters) if _understood(n, marker)]
    unknown = [n for n in given.parameters if not _understood(n, marker)]
    names = [given.parameters[i] for i in understood]
    sigma = np.array(
        [given.standard_uncertainty[i] * unit(given.parameters[i]) for i in understood]
    )
    correlation = given.correlation[np.ix_(understood, understood)]
    degrees = given.degrees_of_freedom or float("inf")
    return names, [correlation * np.outer(sigma, sigma)], unknown, degrees


def unit(name: str) -> float:
    """SI units (or pixels, or one) in a unit of the parameter, by its name's suffix."""
    return UNITS.get(name.rsplit("_", 1)[-1], 1.0)


def _understood(name: str, marker: Marker) -> bool:
    head, _, key = name.partition(".")
    if head in ("left", "right"):
        return CAMERA_KEYS.match(key) is not None
    if head == "robot_base":
        return key in BODY
    led, _, axis = key.rpartition(".")
    return head == "led" and led in marker.names and axis in ("x_mm", "y_mm", "z_mm")


def _body(marker: Marker) -> tuple[list[str], Array]:
    if marker.body_standard_uncertainty is None:
        return [], np.zeros(0)
    return [f"body.{key}" for key in BODY], marker.body_standard_uncertainty


def _leds(marker: Marker, given: list[str]) -> tuple[list[str], Array]:
    sigma = marker.led_standard_uncertainty
    if sigma is None or any(n.startswith("led.") for n in given):
        return [], np.zeros(0)  # a covariance says more than one number for all
    names = [f"led.{led}.{axis}_mm" for led in marker.names for axis in AXES]
    return names, np.full(len(names), sigma)


def _centres(marker: Marker) -> tuple[list[str], Array]:
    sigma = marker.centre_shift_standard_uncertainty
    if sigma is None:
        return [], np.zeros(0)
    names = [f"centre.{led}.{axis}_mm" for led in marker.names for axis in AXES]
    return names, np.full(len(names), sigma)


def _source(name: str) -> str:
    head = name.partition(".")[0]
    return {
        "left": "rig",
        "right": "rig",
        "robot_base": "robot base",
        "body": "LED body",
        "led": "LED positions",
        "centre": "apparent LED centre",
    }[head]


def _uncounted(names: list[str], placed: bool, pan: bool) -> tuple[str, ...]:
    present = {_source(n) for n in names}
    places = ["rig", "robot base", "LED body", "LED positions", "apparent LED centre"]
    missing = [p for p in places if p not in present]
    if placed and "LED body" in missing:
        missing.remove("LED body")
    return (*missing, *(["pan angle"] if pan else []), "robot table")


def sensitivities(parameters: Systematics, seen: Measurement, rig: Rig, marker: Marker) -> Array:
    """How the measured pose in the robot's base changes with each parameter; (6, p + 2).

    The last two columns are the left and the right pan reading. Twists in base axes at the
    flange, m and rad a SI unit of the parameter.
    """
    pose, left, right = seen.pose, seen.left, seen.right
    if pose is None or left is None or right is None:
        raise ValueError("only a measured pair has sensitivities")
    base_R_rig = rig.rig_T_base[:3, :3].T
    gain = np.concatenate([base_R_rig @ pose.gain[:3], base_R_rig @ pose.gain[3:]])
    columns = np.zeros((6, len(parameters.names) + 2))
    views = _views(pose.rig_T_flange, left, right, pose.sensitivity, rig, marker)
    spotted, places = [], []
    for i, name in enumerate((*parameters.names, "left.pan_zero_deg", "right.pan_zero_deg")):
        if name.startswith("robot_base."):
            columns[:, i] = _base(name, rig, pose)
        else:
            spotted.append(_pixels(views, name).reshape(-1))
            places.append(i)
    columns[:, places] = -gain @ np.array(spotted).T
    return columns


def spot_columns(
    parameters: Systematics,
    left: Sighting,
    right: Sighting,
    rig_T_flange: Array,
    by_point: Array,
    rig: Rig,
    marker: Marker,
) -> Array:
    """Columns of unit variance: how what is stated moves the spots that a pose predicts.

    Args:
        parameters: stated; a robot base moves no spot.
        left: LEDs in the left image.
        right: LEDs in the right image.
        rig_T_flange: (4, 4), the pose.
        by_point: (s, 2, 3), d px / d point in the rig, left spots first.
        rig: the cameras.
        marker: the LEDs.

    Returns:
        (2 s, p), px, left spots first.
    """
    views = _views(rig_T_flange, left, right, by_point, rig, marker)
    names = [n for n in parameters.names if not n.startswith("robot_base.")]
    places = [parameters.names.index(n) for n in names]
    spread = root(parameters.covariance[np.ix_(places, places)])
    moved = [_pixels(views, name).reshape(-1) for name in names]
    columns = [np.stack(moved, axis=1) @ spread] if names else [np.zeros((2 * len(views.led), 0))]
    for side, sigma in zip(("left", "right"), parameters.pan, strict=True):
        if sigma > 0:
            turned = _pixels(views, f"{side}.pan_zero_deg")
            columns.append(turned.reshape(-1, 1) * sigma)
    return np.concatenate(columns, axis=1)


def root(covariance: Array) -> Array:
    """A matrix whose square is the covariance, (p, q), without the directions of no variance."""
    sigma = np.sqrt(np.diag(covariance))
    safe = np.where(sigma > 0, sigma, 1.0)  # metres beside pixels: scaled before the eigenvalues
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    some = values > 1e-12  # of a correlation matrix: rounding
    found: Array = sigma[:, None] * vectors[:, some] * np.sqrt(values[some])
    return found


@dataclass(frozen=True, slots=True)
class _Views:
    """Everything about the spots that a derivative needs."""

    side: tuple[tuple[str, Camera, Sighting, slice, Array], ...]  # …, (m, 3) points in the camera
    points_rig: Array  # (s, 3)
    led: Array  # (s,) index
    names: tuple[str, ...]
    offset: Array  # (s, 3), LED from flange, rig axes
    rig_R_flange: Array  # (3, 3)
    by_point: Array  # (s, 2, 3), d px / d point in the rig
    by_led: Array  # (s, 2, 3), d px / d LED in the flange


def _views(
    rig_T_flange: Array, left: Sighting, right: Sighting, by_point: Array, rig: Rig, marker: Marker
) -> _Views:
    led = np.concatenate([left.led, right.led])
    rig_R_flange = rig_T_flange[:3, :3]
    offset = marker.leds[led] @ rig_R_flange.T
    points = offset + rig_T_flange[:3, 3]
    sides = []
    for name, camera, sighting, spots in (
        ("left", rig.left, left, slice(0, len(left))),
        ("right", rig.right, right, slice(len(left), None)),
    ):
        camera_T_rig = camera.camera_T_rig(sighting.pan)
        inside = points[spots] @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3]
        sides.append((name, camera, sighting, spots, inside))
    return _Views(
        tuple(sides),
        points,
        led,
        marker.names,
        offset,
        rig_R_flange,
        by_point,
        by_point @ rig_R_flange,
    )


def _pixels(views: _Views, name: str) -> Array:
    """Derivative of the predicted spots by a parameter, (s, 2), px a SI unit."""
    head, _, key = name.partition(".")
    if head in ("left", "right"):
        return _by_camera(views, head, key)
    if head == "body":
        moved = _body_motion(key, views)
        pixels: Array = (views.by_point @ moved[:, :, None])[:, :, 0]
        return pixels
    led, _, axis = key.rpartition(".")
    chosen = views.led == views.names.index(led)
    by_axis: Array = views.by_led[:, :, AXES.index(axis[0])] * chosen[:, None]
    return by_axis


def _by_camera(views: _Views, head: str, key: str) -> Array:
    pixels = np.zeros((len(views.led), 2))
    for side, camera, sighting, spots, inside in views.side:
        if side == head:
            points, by_point = views.points_rig[spots], views.by_point[spots]
            pixels[spots] = camera_pixels(key, camera, sighting, inside, points, by_point)
    return pixels


def camera_pixels(
    key: str, camera: Camera, sighting: Sighting, inside: Array, points: Array, by_point: Array
) -> Array:
    """Derivative of one camera's pixels by one of its parameters, (m, 2)."""
    xy = inside[:, :2] / inside[:, 2:3]
    if key in ("cx_px", "cy_px"):
        return np.tile([float(key == "cx_px"), float(key == "cy_px")], (len(xy), 1))
    if key in ("fx_px", "fy_px"):
        return distort(xy, camera.distortion) * [float(key == "fx_px"), float(key == "fy_px")]
    if key in LENS:  # the model is linear in its coefficients
        unit = np.array([float(key == k) for k in LENS])
        lens: Array = (distort(xy, unit) - xy) @ camera.matrix[:2, :2].T
        return lens
    shift, turn, origin = _camera_motion(key, camera, sighting.pan)
    moved = -(shift + _swept(turn, points - origin))  # the world moves against the camera
    pixels: Array = (by_point @ moved[:, :, None])[:, :, 0]
    return pixels


def _swept(turn: Array, points: Array) -> Array:
    """Cross product turn x points, (m, 3); numpy's own takes five times as long for one vector."""
    x, y, z = turn.tolist()
    swept: Array = points @ np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    return swept


def _camera_motion(key: str, camera: Camera, pan: float) -> tuple[Array, Array, Array]:
    """Translation, rotation vector and its origin, in rig axes, of a camera a unit parameter."""
    none = np.zeros(3)
    turned = cv2.Rodrigues(camera.pan_axis * (pan + camera.pan_zero))[0]
    if key == "pan_zero_deg":
        return none, camera.pan_axis, camera.pan_center
    what, axis, _ = key.rsplit("_", 2)
    unit = np.eye(3)[AXES.index(axis[-1])]
    if what == "pan_center":
        return unit, none, none
    if what == "pan_axis":
        return none, unit - turned @ unit, camera.pan_center
    if axis.startswith("r"):
        return none, turned @ unit, camera.rig_T_camera(pan)[:3, 3]
    return turned @ unit, none, none


def _body_motion(key: str, views: _Views) -> Array:
    """Motion of each seen LED in the rig for a unit of a displacement of all, (s, 3)."""
    unit = views.rig_R_flange[:, AXES.index(key.split("_")[0][-1])]
    if key.startswith("r"):
        return _swept(unit, views.offset)
    return np.tile(unit, (len(views.led), 1))


def _base(name: str, rig: Rig, pose: Pose) -> Array:
    """Change of the flange's pose in the base when the base's place in the rig changes, (6,)."""
    key = name.partition(".")[2]
    unit = np.eye(3)[AXES.index(key.split("_")[0][-1])]
    base_R_rig = rig.rig_T_base[:3, :3].T
    if not key.startswith("r"):
        return np.concatenate([-base_R_rig @ unit, np.zeros(3)])
    arm = pose.rig_T_flange[:3, 3] - rig.rig_T_base[:3, 3]
    return np.concatenate([-base_R_rig @ _swept(unit, arm), -base_R_rig @ unit])
