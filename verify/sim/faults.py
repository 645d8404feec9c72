"""What an encoder at fault adds to the true angle, as docs/results.md defines it."""

from collections.abc import Sequence

import numpy as np

from verify.records import Array
from verify.sim.scenario import Fault


def reading_error(q: Array, direction: Array, faults: Sequence[Fault]) -> Array:
    """Reading less true angle: offset + gain q + backlash/2 d + ecc cos(n (q - phase)).

    Args:
        q: (..., joints), rad, the true angles in the robot file's zero.
        direction: (..., joints), +1 or -1, the last direction of travel, kept at rest.
        faults: any number of them, also several on one joint.

    Returns:
        (..., joints), rad.
    """
    error = np.zeros_like(q)
    for fault in faults:
        k = fault.joint - 1
        turn = fault.per_turn * (q[..., k] - np.radians(fault.phase_deg))
        error[..., k] += (
            np.radians(fault.offset_deg)
            + fault.gain * q[..., k]
            + np.radians(fault.backlash_deg) / 2 * direction[..., k]
            + np.radians(fault.eccentricity_deg) * np.cos(turn)
        )
    return error
