"""How well a motion would tell the encoders' clock, in worlds that are off as rig and LEDs state.

What joint offsets alone do not explain counts against a clock that is found from the motion: a
world without errors would flatter it. So worlds are drawn, and the clock is sought in each.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.clock import ClockEstimate, estimate_clock
from verify.comparison import compare
from verify.judgement.model import prior_columns
from verify.readings import Readings
from verify.records import Array
from verify.systematics import Systematics
from verify.track import Track

WORLDS = 5


def foreseen_clock(
    track: Track,
    arm: robots.Arm,
    readings: Readings,
    systematics: Systematics,
    rng: np.random.Generator,
) -> ClockEstimate:
    """Find the clock in worlds drawn about what is stated.

    Args:
        track: poses without noise.
        arm: the robot.
        readings: on the cameras' clock.
        systematics: what rig and marker state.
        rng: draws the worlds.

    Returns:
        The offset of the perfect world, 0 but for the readings' noise, with the median uncertainty
        of all; the perfect world's alone where the LEDs leave a turn open.
    """
    perfect = estimate_clock(track, arm, readings)
    full = bool((track.known_dof == 6).all())
    if perfect.source != "estimated" or not full:  # with turns left open the search takes minutes
        return perfect
    exact = ClockEstimate(0.0, None, "given", np.zeros((0, 2)))
    comparison = compare(track, arm, readings, 0.0)
    columns = prior_columns(comparison, track, exact, systematics)
    roots = np.linalg.cholesky(track.covariance_pixels[comparison.index])
    sizes = []
    for _ in range(WORLDS):
        off = columns @ rng.standard_normal(columns.shape[2])
        noise = rng.standard_normal((len(comparison), 6, 1))
        twist = np.zeros((len(track), 6))
        twist[comparison.index] = off + (roots @ noise)[:, :, 0]
        found = estimate_clock(_moved(track, twist), arm, readings)
        # one that is not found in some world is as good as unknown there
        sizes.append(found.standard_uncertainty or np.inf)
    typical = float(np.median(sizes))
    if not np.isfinite(typical):
        return replace(perfect, offset=0.0, standard_uncertainty=None, source="not_observable")
    return replace(perfect, standard_uncertainty=typical)


def _moved(track: Track, twist: Array) -> Track:
    """Move every pose by a twist (n, 6), base axes at the flange."""
    poses = track.base_T_flange.copy()
    poses[:, :3, :3] = Rotation.from_rotvec(twist[:, 3:]).as_matrix() @ poses[:, :3, :3]
    poses[:, :3, 3] += twist[:, :3]
    return replace(track, base_T_flange=poses)
