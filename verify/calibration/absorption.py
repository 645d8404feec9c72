"""What a registration through the robot's own encoders hides: joint offsets that it took in.

An offset that was there while base and LEDs were fitted displaced them. How, is linear algebra:
no fault has to be known for it.
"""

import numpy as np

from verify.calibration.motion_adjust import Adjusted, block_diagonal
from verify.calibration.motion_model import BASE, cross
from verify.errors import InputError
from verify.marker import Marker
from verify.records import Array
from verify.rig import Rig

INVISIBLE = 1e-3  # a share below this is what rounding leaves of nothing


def inherited(rig: Rig, marker: Marker | None, *, base: bool, leds: bool) -> Array | None:
    """What was held had taken in already, by its own registration, (6 + 3 n, j); None: nothing.

    Args:
        rig: the rig that was registered in.
        marker: the marker whose LEDs were held, if they were.
        base: the base was held.
        leds: the LEDs were held.

    Raises:
        InputError: what is held was fitted through the encoders, and how is not known.
    """
    base = base and rig.base_source == "motion"
    kept = marker if leds and marker is not None and marker.source == "motion" else None
    if not base and kept is None:
        return None
    strange = kept is not None and kept.registration != rig.registration
    if rig.absorption is None or strange:
        raise InputError(
            "--keep-base" if kept is None else "--keep-leds",
            "what is to be kept was fitted through the robot's encoders, and the rig does not "
            "hold that registration's absorption",
            "",
            "Give the rig.toml that the same registration wrote, or fit both anew.",
        )
    if kept is None:
        return rig.absorption[:6]
    return np.concatenate(
        [np.zeros_like(rig.absorption[:6]), _motion(kept.leds) @ rig.absorption[6:]]
    )


def _motion(leds: Array) -> Array:
    """What a motion of the LED body does to its LEDs, (3 n, 6)."""
    motion = np.concatenate([np.tile(np.eye(3), (len(leds), 1, 1)), -cross(leds)], axis=2)
    return motion.reshape(-1, 6)


def taken_in(adjusted: Adjusted, held: Array | None = None) -> Array:
    """By how much each parameter would make up for a radian of joint offset, (size, j).

    G = (H'S⁻¹H)⁺ H'S⁻¹ J with H the derivatives of the predicted spots by the parameters, J those
    by the readings. A joint that reads too high by d moved what was fitted by -G d.
    """
    design = np.where(adjusted.free, adjusted.rows.design, 0.0)
    before = np.zeros((adjusted.at.size, adjusted.rows.joints.shape[1]))
    if held is not None:
        before[: len(held)] = held
    left = adjusted.rows.joints - adjusted.rows.design @ before
    taken: Array = before + adjusted.inverse @ (design.T @ left)
    return taken


def absorption(adjusted: Adjusted, held: Array | None = None) -> Array:
    """Lay `taken_in` out as rig.toml holds it: base and LED-body motion a radian, (12, j).

    Rows 0 to 5: the base in rig axes (m, then rad), its turns about its own origin. Rows 6 to 11:
    the rigid part of the LEDs' change, in flange axes about the flange's origin. Rows of what was
    held are 0. As `judgement.model` reads it, what an offset does to a later session is its own
    effect less that of these motions: they are the negative of what the offset really did.
    """
    taken = taken_in(adjusted, held)
    body = np.linalg.lstsq(_motion(adjusted.at.leds), taken[6:-2], rcond=None)[0]
    return np.concatenate([taken[BASE], body])


def visible_fractions(adjusted: Adjusted, held: Array | None = None) -> Array:
    """Share of a constant offset of each joint that its own registration leaves in the pictures.

    ||S^-½ (J - H G)|| / ||S^-½ J||, S the spots' own noise, (j,): 0 for what is hidden altogether.
    """
    taken, seen, spotted = taken_in(adjusted, held), adjusted.predicted, adjusted.spotted
    design = seen.design
    left, whole = np.zeros(taken.shape[1]), np.zeros(taken.shape[1])
    for i in range(len(spotted)):
        mine = (spotted.pair == i) & spotted.used
        lower = np.linalg.cholesky(block_diagonal(spotted.covariance[mine]))
        joints = seen.by_joint[mine].reshape(len(lower), -1)
        hidden = joints - design[mine].reshape(len(lower), -1) @ taken
        left += np.sum(np.linalg.solve(lower, hidden) ** 2, axis=0)
        whole += np.sum(np.linalg.solve(lower, joints) ** 2, axis=0)
    share = np.sqrt(np.divide(left, whole, out=np.zeros_like(left), where=whole > 0))
    return np.where(share < INVISIBLE, 0.0, np.minimum(share, 1.0))
