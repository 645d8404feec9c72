"""Faults that belong to no joint: the clock, the cameras' instants, what moved since registration.

The cameras' columns are made of what a turn about its pan axis does to a pose: the widest part of
what a camera that is late, or was knocked, does to depth.
"""

import numpy as np

from verify.judgement.faults import Fault
from verify.judgement.model import Model, clock_effect
from verify.records import Array
from verify.rig import Rig


def common_faults(model: Model, rig: Rig | None) -> list[Fault]:
    """Every common fault, those included that this session cannot show: their columns are 0."""
    comparison = model.comparison
    short = -clock_effect(comparison, steady=True)  # of an offset that wants a second more
    elapsed = (comparison.t - comparison.t[0])[:, None, None]
    columns: list[tuple[str, str, Array]] = [
        ("clock_drift", "ppm", short * elapsed),
        ("base_moved", "mm", -base_motion(comparison.base_T_jacobian)),
        ("led_body_slipped", "mm", -body_motion(comparison.base_T_jacobian)),
        ("camera_turned", "deg", -comparison.systematic[:, :, [-1]]),
    ]
    if not model.seen.clock.shape[1]:  # else the offset was fitted, and there is none to correct
        columns.append(("clock", "s", short))
    if rig is not None:
        columns.append(("camera_skew", "s", skew_effect(model, rig)))
    return [Fault(kind, None, unit, model.white.rows(c)) for kind, unit, c in columns]


def base_motion(base_T_flange: Array) -> Array:
    """Twist (n, 6, 6) of the flange for a motion of what it stands on, base axes."""
    motion = np.tile(np.eye(6), (len(base_T_flange), 1, 1))
    for k in range(3):
        motion[:, :3, 3 + k] = np.cross(np.eye(3)[k], base_T_flange[:, :3, 3])
    return motion


def body_motion(base_T_flange: Array) -> Array:
    """Twist (n, 6, 6) of the flange for a motion of itself in its own axes."""
    motion = np.zeros((len(base_T_flange), 6, 6))
    motion[:, :3, :3] = motion[:, 3:, 3:] = base_T_flange[:, :3, :3]
    return motion


def skew_effect(model: Model, rig: Rig) -> Array:
    """What a second by which the right picture is later than stamped does to xi, (n, 6, 1).

    Half of it is a common delay of both pictures; the other half turns the right camera's rays on
    and the left one's back, by the angle that the LEDs pass in it, and shows as depth. How the
    rays cross above and below is left out: it shows in the residuals of the spots, not in the pose.
    """
    comparison = model.comparison
    speed = np.einsum("nij,nj->ni", comparison.jacobian, comparison.rate)[:, :3]
    rig_R_base = rig.rig_T_base[:3, :3]
    place = comparison.base_T_jacobian[:, :3, 3] @ rig_R_base.T + rig.rig_T_base[:3, 3]
    velocity = speed @ rig_R_base.T
    apart = np.zeros((len(comparison), 6))
    for camera, column, sign in ((rig.left, -2, -0.5), (rig.right, -1, 0.5)):
        arm = place - camera.pan_center
        arm = arm - np.outer(arm @ camera.pan_axis, camera.pan_axis)
        turning = np.cross(arm, velocity) @ camera.pan_axis / np.sum(arm**2, axis=1)
        apart += sign * turning[:, None] * comparison.systematic[:, :, column]
    if not apart.any():  # no cameras, or nothing moves across them
        return np.zeros((len(comparison), 6, 1))
    effect: Array = apart[:, :, None] + clock_effect(comparison, steady=True) / 2
    return effect
