"""A rig that does not exist yet, built from camera, baseline and distance to the arm's work.

Model, rig frame (x along the baseline, y down, z towards the work), for a picture of w columns and
a horizontal field of view a:

    f = w / (2 tan(a / 2)),   both cameras at (-+ b / 2, 0, 0), turned inwards by atan(b / (2 d))

so that both optical axes meet in the middle of the LEDs at the work posture. LEDs stand on a circle
at uneven angles and heights, so that they are identified and do not lie in one plane.

Assumed standard uncertainties, a parameter each, stand for a calibration and a registration that
nobody has made yet. Of correlations only that of a camera's two focal lengths is assumed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

import robots
from verify.core.fiducials import Marker
from verify.core.records import Array, rigid_transform
from verify.core.rig import Camera, Covariance, Rig
from verify.errors import InputError
from verify.planning.constraints import dexterity
from verify.planning.request import PlanningSetup

TYPICAL_UNCERTAINTIES = {
    "focal_px": 0.1,  # each focal length
    "principal_point_px": 0.1,  # each coordinate of a principal point
    "camera_rotation_deg": 0.002,  # right camera against left, each axis
    "base_position_mm": 0.1,  # robot base in the rig, each axis
    "base_rotation_deg": 0.01,
    "led_body_mm": 0.05,  # all LEDs together, flange axes
    "led_body_deg": 0.02,
    "led_mm": 0.02,  # each LED in the body, each axis
    "led_centre_mm": 0.02,  # apparent LED centre, each axis
}
FOCAL_CORRELATION = 0.9  # a board fixes the ratio far better than the common size
LED_DIAMETER = 5e-3  # m
MAX_LEDS = 6
# angle, degrees, and height over the flange, share of the circle's radius
LED_PLACES = ((5, 0.3), (144, 0.2), (250, 0.45), (63, 0.6), (196, 0.75), (308, 0.1))
N_POSTURES = 20_000  # drawn for a work posture
MAX_TILT = 0.35  # of the flange's z from level, its sine
MIN_OUTWARD = 0.5  # cosine between the flange's z and the way out from the base
MIN_REACH = 0.5  # of the farthest flange that was drawn: the arm is not folded
LIMIT_SHARE = 0.8  # of each joint's range about its middle: room to turn both ways
N_DIRECTIONS = 600  # about 6° apart over the sphere: no LED's view changes much in between
MIN_EYE_HEIGHT = 0.2  # m over the floor
MAX_VIEW = np.deg2rad(45.0)  # of the cameras from the flange's z


@dataclass(frozen=True, slots=True)
class ProposedRig:
    """Two like cameras that converge on the arm's work, and LEDs on a circle."""

    image_size: tuple[int, int] = (1280, 720)  # px
    field_of_view: float = float(np.deg2rad(60.0))  # rad, horizontal
    baseline: float = 0.4  # m
    distance: float = 1.0  # m, middle of the baseline to the LEDs at the work posture
    leds: int = 4
    led_circle: float = 0.12  # m, diameter
    uncertainties: dict[str, float] = field(default_factory=lambda: dict(TYPICAL_UNCERTAINTIES))

    @property
    def focal(self) -> float:
        """In px."""
        return self.image_size[0] / 2 / float(np.tan(self.field_of_view / 2))

    @property
    def vergence(self) -> float:
        """By which each camera is turned inwards, rad."""
        return float(np.arctan2(self.baseline / 2, self.distance))


def work_posture(arm: robots.Arm, floor: float) -> Array:
    """Choose a posture (j,), rad, that cameras can stand before: reaching out, far from singular.

    Raises:
        InputError: the arm has none.
    """
    rng = np.random.default_rng(0)  # the same place for every rig of an arm
    middle, half = (arm.lower + arm.upper) / 2, LIMIT_SHARE * (arm.upper - arm.lower) / 2
    q = rng.uniform(middle - half, middle + half, (N_POSTURES, arm.dof))
    q[:, 0] = middle[0]
    frames = robots.link_frames(arm, q)
    place, ahead = frames[:, -1, :3, 3], frames[:, -1, :3, 2]
    reach = np.linalg.norm(place[:, :2], axis=1)
    out = place[:, :2] / np.maximum(reach, 1e-9)[:, None]
    score = dexterity(frames)
    score[np.abs(ahead[:, 2]) > MAX_TILT] = -1.0
    score[np.sum(ahead[:, :2] * out, axis=1) < MIN_OUTWARD] = -1.0
    score[reach < MIN_REACH * reach.max()] = -1.0
    score[(frames[:, 1:, 2, 3] < floor + MIN_EYE_HEIGHT).any(axis=1)] = -1.0
    best = int(np.argmax(score))
    if score[best] <= 0:
        raise InputError(
            "plan", f"no posture of {arm.name} reaches out level above the floor",
            "the cameras stand before such a posture", "Give a posture with --near.",
        )  # fmt: skip
    return np.asarray(q[best])


def build_setup(arm: robots.Arm, proposed: ProposedRig, work: Array, floor: float) -> PlanningSetup:
    """Place the rig before a work posture (j,), rad, as level as the LEDs' direction allows.

    Raises:
        InputError: no place above the floor, m, base frame, has the LEDs in view.
    """
    base_T_flange = robots.forward(arm, work[None])[0]
    marker = _marker(proposed)
    target = base_T_flange[:3, :3] @ marker.leds.mean(axis=0) + base_T_flange[:3, 3]
    directions = np.concatenate([base_T_flange[None, :3, 2], spread_directions()])
    toward = directions @ base_T_flange[:3, 2]
    eyes = target + proposed.distance * directions
    usable = (toward > np.cos(MAX_VIEW)) & (eyes[:, 2] > floor + MIN_EYE_HEIGHT)
    if not usable.any():
        raise InputError(
            "--near", "the flange looks down at this posture",
            f"the cameras stand {MIN_EYE_HEIGHT:g} m or more above the floor, where the LEDs face "
            f"them within {np.rad2deg(MAX_VIEW):.0f}°",
            "Give a posture whose flange faces a place for the cameras, or a lower --floor-mm.",
        )  # fmt: skip
    eye = eyes[int(np.argmax(np.where(usable, toward, -2.0)))]
    size, half, inwards = proposed.image_size, proposed.baseline / 2, proposed.vergence
    rig = Rig(
        image_size=size,
        left=level_camera(size, proposed.focal, -half, inwards),
        right=level_camera(size, proposed.focal, half, -inwards),
        rig_T_base=look_at(eye, target),
        covariance=stated_covariance(proposed.uncertainties),
    )
    return PlanningSetup(arm, rig, marker)


def level_camera(size: tuple[int, int], focal: float, x: float, pan: float) -> Camera:
    """A camera at (x, 0, 0) of the rig, m, turned to pan, rad; size and focal length in px."""
    middle = (np.array(size) - 1) / 2
    return Camera(
        matrix=np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        pan_center=np.array([x, 0.0, 0.0]),
        pan_axis=np.array([0.0, 1.0, 0.0]),
        pan_zero=0.0,
        mount=np.eye(4),
        pan=pan,
    )


def _marker(proposed: ProposedRig) -> Marker:
    angle, height = np.array(LED_PLACES[: proposed.leds], dtype=float).T
    angle, radius, u = np.deg2rad(angle), proposed.led_circle / 2, proposed.uncertainties
    places = np.stack([np.cos(angle), np.sin(angle), height], axis=1) * radius
    body = [u["led_body_mm"] * 1e-3] * 3 + [float(np.deg2rad(u["led_body_deg"]))] * 3
    return Marker(
        names=tuple("ABCDEF"[: proposed.leds]),
        leds=places,
        colours=(None,) * proposed.leds,
        led_diameter=LED_DIAMETER,
        source="jig",
        body_standard_uncertainty=np.array(body) if any(body) else None,
        led_standard_uncertainty=u["led_mm"] * 1e-3 or None,
        centre_shift_standard_uncertainty=u["led_centre_mm"] * 1e-3 or None,
    )


def stated_covariance(uncertainties: Mapping[str, float]) -> Covariance | None:
    """What rig.toml would state of uncertainties by the keys of TYPICAL_UNCERTAINTIES; 0 is exact.

    Only a camera's two focal lengths, which follow one another, are correlated.
    """
    groups = (
        ("focal_px", ["left.fx_px", "left.fy_px"]),
        ("principal_point_px", ["left.cx_px", "left.cy_px"]),
        ("focal_px", ["right.fx_px", "right.fy_px"]),
        ("principal_point_px", ["right.cx_px", "right.cy_px"]),
        ("camera_rotation_deg", [f"right.mount_r{axis}_deg" for axis in "xyz"]),
        ("base_position_mm", [f"robot_base.{axis}_mm" for axis in "xyz"]),
        ("base_rotation_deg", [f"robot_base.r{axis}_deg" for axis in "xyz"]),
    )
    stated = [(name, u) for key, names in groups if (u := uncertainties[key]) > 0 for name in names]
    if not stated:
        return None
    names, correlation = tuple(name for name, _ in stated), np.eye(len(stated))
    for i, name in enumerate(names):
        if name.endswith("fx_px"):
            correlation[i, i + 1] = correlation[i + 1, i] = FOCAL_CORRELATION
    return Covariance(names, np.array([u for _, u in stated]), correlation)


def look_at(eye: Array, target: Array) -> Array:
    """Stand at `eye`, z towards `target`, x level (or along -y, looking straight up or down).

    Returns camera_T_world, (4, 4), of eye and target (3,), m, in a world whose z points up.
    """
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(x) < 1e-6:
        x = np.array([0.0, -1.0, 0.0])
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z])
    return rigid_transform(turn, -np.squeeze(turn @ eye[:, None], -1))


def spread_directions() -> Array:
    """Unit vectors (n, 3) spread evenly over the sphere: a Fibonacci spiral."""
    i = np.arange(N_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * i / N_DIRECTIONS, np.pi * (1 + np.sqrt(5)) * i
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
