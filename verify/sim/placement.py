"""Where to stand the rig before the robot so that every LED is seen in every pair."""

from dataclasses import dataclass

import numpy as np

from verify.errors import InputError
from verify.records import Array
from verify.sim.bench import Bench, SimulatedCamera, build_bench, rigid
from verify.sim.scenario import Placement, Scenario

MARGIN_PX = 25.0  # from the edge to an LED's centre: a spot of 5 mm and its blur stay inside
WANTED_COSINE = 0.5  # 60°: beyond it a flat LED is a sliver and a dome hides behind its holder
DIRECTIONS = 600  # about 6° apart over the sphere: no LED's view changes much in between
STEPS_BACK = (1.0, 1.1, 1.2, 1.35, 1.5)  # of the wanted distance, where the view is too narrow


@dataclass(frozen=True, slots=True)
class Stand:
    """Where the base is in the rig, and how the camera bases are turned in every pair."""

    rig_T_base: Array  # (4, 4)
    pan: Array  # (pairs, 2), rad, as set: left, right


def place(scenario: Scenario, points: Array, normals: Array) -> Stand:
    """Take the scenario's placement, or look for one.

    Args:
        scenario: its rig table says what is wanted.
        points: (pairs, leds, 3), m, the LEDs in the robot's base frame.
        normals: (pairs, leds, 3), where they shine.

    Raises:
        InputError: no direction shows every LED in every pair.
    """
    rig = scenario.rig
    if isinstance(rig.placement, Placement):
        rig_T_base = rigid(
            np.radians(rig.placement.base_rotation_deg),
            np.asarray(rig.placement.base_position_mm) / 1000,
        )
        bench = build_bench(scenario, rig_T_base)
        if rig.bases == "follow":
            return Stand(rig_T_base, _pans(scenario, bench, points))
        return Stand(rig_T_base, np.tile(np.radians(rig.placement.pan_deg), (len(points), 1)))
    target: Array = points.reshape(-1, 3).mean(axis=0)
    for back in STEPS_BACK:
        distance = back * rig.distance_mm / 1000
        eyes = target + distance * _directions()
        for eye in eyes[_from_best(eyes, points, normals)]:
            rig_T_base = _looking(eye, target)
            bench = build_bench(scenario, rig_T_base)
            pan = _pans(scenario, bench, points)
            if _all_inside(bench, pan, points):
                return Stand(rig_T_base, pan)
    raise InputError(
        "rig.placement",
        f"no place near {rig.distance_mm:g} mm shows every LED in every pair, at most 60° from "
        "where it shines",
        remedy="Make the motion smaller, the distance longer, or let the bases follow.",
    )


def _directions() -> Array:
    """Spread unit vectors evenly over the sphere (a Fibonacci spiral), level ones first served."""
    i = np.arange(DIRECTIONS) + 0.5
    z = 1 - 2 * i / DIRECTIONS
    angle = np.pi * (1 + np.sqrt(5)) * i
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def _from_best(eyes: Array, points: Array, normals: Array) -> Array:
    """Order the eyes (e, 3) that see every LED within 60°, the one that sees them best first."""
    toward = eyes[:, None, None] - points
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    worst = np.sum(toward * normals, axis=-1).min(axis=(1, 2))
    order = np.argsort(-worst, kind="stable")
    best: Array = order[worst[order] > WANTED_COSINE]
    return best


def _looking(eye: Array, target: Array) -> Array:
    """Stand the rig at `eye`, looking at `target`, its x level (or along y, seen from above)."""
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    if np.linalg.norm(x) < 1e-6:  # looking straight down or up
        x = np.array([0.0, -1.0, 0.0])
    x /= np.linalg.norm(x)
    rig_T_base = np.eye(4)
    rig_T_base[:3, :3] = np.stack([x, np.cross(z, x), z])
    rig_T_base[:3, 3] = -rig_T_base[:3, :3] @ eye
    return rig_T_base


def _pans(scenario: Scenario, bench: Bench, points: Array) -> Array:
    """Turn each base towards the LEDs' mean, of each pair or of all, in whole steps."""
    rig = scenario.rig
    in_rig = points @ bench.rig_T_base[:3, :3].T + bench.rig_T_base[:3, 3]
    means = in_rig.mean(axis=1)
    if rig.bases == "fixed":
        means = np.tile(means.mean(axis=0), (len(means), 1))
    step = np.radians(rig.pan_step_deg)
    pans = np.stack([_aim(camera, means) for camera in bench.cameras], axis=1)
    stepped: Array = np.round(pans / step) * step
    return stepped


def _aim(camera: SimulatedCamera, targets: Array) -> Array:
    """Find the pan at which the optical axis passes the targets (n, 3) nearest, (n,) rad."""
    axis = camera.pan_axis
    ahead = camera.turntable_T_camera[:3, 2]

    def across(v: Array) -> Array:
        flat: Array = v - (v @ axis)[..., None] * axis
        return flat

    start, toward = across(ahead), across(targets - camera.pan_center)
    sine = np.cross(start, toward) @ axis
    angle: Array = np.arctan2(sine, toward @ start) - camera.pan_zero
    return angle


def _all_inside(bench: Bench, pan: Array, points: Array) -> bool:
    """Tell if both cameras have every LED well inside the picture in every pair."""
    in_rig = points @ bench.rig_T_base[:3, :3].T + bench.rig_T_base[:3, 3]
    for side, camera in enumerate(bench.cameras):
        limit = np.array(camera.image_size) - 1 - MARGIN_PX
        turns, pairs = np.unique(pan[:, side], return_inverse=True)
        for i, turn in enumerate(turns):  # fixed bases: one projection of all pairs
            pixels = camera.project(in_rig[pairs == i], turn)
            if not np.all((pixels > MARGIN_PX) & (pixels < limit)):  # NaN fails too
                return False
    return True
