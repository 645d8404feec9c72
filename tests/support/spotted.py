"""Pairs measured at spot level, with all that a session states: spots by OpenCV."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

import robots
from tests.support.drawn_rig import random_correlation
from tests.support.motions import HOME
from tests.support.scene import facing, make_marker, make_rig, sight
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import compare, solve_joints
from verify.analysis.model import SessionComparison
from verify.analysis.uncertainty.monte_carlo import MonteCarlo, monte_carlo
from verify.core.readings import Readings
from verify.core.records import Array, Measurement
from verify.core.rig import Covariance
from verify.io.session.session import Session
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import sensitivities, stated_systematics
from verify.measurement.track import collect_track

SPOT_SIGMA = 0.03  # px
STATED = {
    **{f"{side}.{k}_px": 0.3 for side in ("left", "right") for k in ("fx", "fy", "cx", "cy")},
    **{f"right.mount_r{axis}_deg": 0.01 for axis in "xyz"},
    **{f"right.pan_axis_r{axis}_deg": 0.01 for axis in "xz"},
    "left.k1": 0.002,
    "left.pan_center_x_mm": 0.05,
    **{f"robot_base.{axis}_mm": 0.1 for axis in "xyz"},
    **{f"robot_base.r{axis}_deg": 0.02 for axis in "xyz"},
}


@dataclass(frozen=True)
class Spotted(SessionComparison):
    """A compared session with its measured pairs."""

    measurements: list[Measurement]

    def check(self, **options: Any) -> MonteCarlo:
        """Run the Monte-Carlo check."""
        found = monte_carlo(self, **options)
        assert found is not None
        return found


def spotted(arm_name: str, q: Array, seed: int, larger: float = 1.0) -> Spotted:
    """Look at an arm at joints q (n, 6), rad; all that is stated times `larger`.

    The robot stands so that the first posture's flange faces the cameras.
    """
    rng = np.random.default_rng(seed)
    arm = robots.load(arm_name)
    names = tuple(STATED)
    u = larger * np.array(list(STATED.values()))
    covariance = Covariance(names, u, random_correlation(rng, len(names), 2 * len(names)))
    home = robots.forward(arm, q[:1])[0]
    rig = replace(make_rig(), rig_T_base=facing() @ np.linalg.inv(home), covariance=covariance)
    pan = larger * np.deg2rad(0.005)
    left, right = (replace(c, pan_standard_uncertainty=pan) for c in (rig.left, rig.right))
    rig = replace(rig, left=left, right=right)
    marker = make_marker(
        source="jig",
        body_standard_uncertainty=larger * np.array([3e-5] * 3 + [np.deg2rad(0.02)] * 3),
        led_standard_uncertainty=larger * 2e-5,
        centre_shift_standard_uncertainty=larger * 1e-5,
    )
    parameters = stated_systematics(rig, marker, turning=True)
    t = 5.0 * np.arange(len(q))
    measurements, effects = [], []
    for i, pose in enumerate(rig.rig_T_base @ robots.forward(arm, q)):
        sightings = sight(rig, marker, pose, SPOT_SIGMA, rng)
        fitted = fit_pose(*sightings, rig, marker, pose)
        seen = Measurement(i, float(t[i]), "measured", len(marker), fitted, *sightings)
        measurements.append(seen)
        effects.append(sensitivities(parameters, seen, rig, marker))
    track = collect_track(measurements, rig, effects)
    log = (t[:, None] + np.linspace(-0.2, 0.2, 9)).ravel()
    noise = np.deg2rad(0.003) * rng.standard_normal((len(log), q.shape[1]))
    comparison = compare(track, arm, Readings(log, np.repeat(q, 9, axis=0) + noise), 0.0)
    session = SimpleNamespace(
        arm=arm, rig=rig, marker=marker, encoder_resolution=None,
        encoder_time_standard_uncertainty=None, instrument=None,
    )  # fmt: skip
    return Spotted(
        session=cast("Session", session),
        measurements=measurements,
        track=track,
        comparison=comparison,
        joints=solve_joints(comparison, arm),
        systematics=parameters,
        clock=ClockEstimate(0.0, 5e-4, "given", np.zeros((0, 2))),
    )


HOMES = {"iust_6r": HOME, "rv_3sd_melfa": np.deg2rad([10.0, 15.0, 95.0, 10.0, 50.0, 20.0])}
SPREAD = np.deg2rad([10.0, 7.0, 8.0, 10.0, 10.0, 20.0])
