"""Results of identified arms, of poses drawn from an arm with known errors. Do not change them."""

from functools import cache

import numpy as np

import robots
from reports.results import Results
from tests.support.true_arm import measured, readings, true_arm
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.identify import IdentificationOptions, identify_arm
from verify.calibration.kinematics.poses import build_poses
from verify.calibration.kinematics.results import (
    IdentificationProvenance,
    ValidationSessions,
    identification_results,
)
from verify.calibration.origin import ResultsOrigin


@cache
def made(geometry: float, *, outlying: bool = False, position_only: bool = False) -> Results:
    truth = true_arm("iust_6r", seed=1, geometry=geometry)
    q = readings(truth.arm, 60, 2)
    seen, covariance = measured(truth, q, 3)
    seen[7, 0, 3] += 0.05 * outlying
    if position_only:
        seen, covariance = seen[:, :3, 3], covariance[:, :3, :3]
    rows = build_poses(q, seen, covariance)
    found = identify_arm(chain_of(truth.arm), rows, IdentificationOptions(splits=2))
    origin = IdentificationProvenance(
        origin=ResultsOrigin("monday"),
        arm=robots.load("iust_6r"),
        names=["monday"],
        source=np.zeros(60, dtype=np.int64),
        frame=np.arange(60),
        free_base=True,
        free_tool=True,
    )
    judged = ValidationSessions(["tuesday"], found.before, found.after) if outlying else None
    return identification_results(found, rows, origin, "iust_6r_identified.urdf", judged)
