"""The stated uncertainty of the mean errors holds the truth: metrology.md section 5 (b), small.

Each replicate draws one true world about the stated rig, base, and marker, projects its LEDs with
OpenCV, and hands the measurement what the files state. The arm is healthy, so every mean error is
zero and d² of the six means follows chi-squared with six degrees of freedom.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import robots
from tests.verify.motions import ARM, HOME
from tests.verify.scene import facing, make_marker, make_rig, sight
from verify.clock import ClockEstimate
from verify.comparison import compare
from verify.joints import solve_joints
from verify.judgement.means import JointErrors, Means, mean_errors
from verify.judgement.model import build
from verify.judgement.resolved import resolve
from verify.marker import Marker
from verify.pose import fit_pose
from verify.readings import Readings
from verify.records import Array, Measurement
from verify.rig import Covariance, Rig
from verify.systematics import Systematics, sensitivities, stated
from verify.track import collect

REPLICATES = 40  # d²/6 is then known to 9 %
VISITS = 6
SPOT_SIGMA = 0.03  # px
SPREAD = np.deg2rad([12.0, 8.0, 9.0, 12.0, 14.0, 25.0])
GIVEN = ClockEstimate(0.0, None, "given", np.zeros((0, 2)))
CAMERAS = [f"{side}.{k}_px" for side in ("left", "right") for k in ("fx", "fy", "cx", "cy")]
TURN = [f"right.mount_r{axis}_deg" for axis in "xyz"]
BASE = [f"robot_base.{axis}_mm" for axis in "xyz"] + [f"robot_base.r{axis}_deg" for axis in "xyz"]
SIGMA = np.array([0.3] * 8 + [0.01] * 3 + [0.1] * 3 + [0.02] * 3)  # in the units of the names


def believed(*, doubts: bool) -> tuple[Rig, Marker]:
    """What the files state: a rig before the arm, a marker of four LEDs."""
    rig = make_rig()
    home = robots.forward(ARM, HOME[None])[0]
    rig = replace(rig, rig_T_base=facing() @ np.linalg.inv(home))
    if not doubts:
        return rig, make_marker()
    names = (*CAMERAS, *TURN, *BASE)
    mixed = np.random.default_rng(0).normal(size=(len(names), len(names) + 20))
    spread = mixed @ mixed.T
    size = np.sqrt(np.diag(spread))
    stated_rig = replace(rig, covariance=Covariance(names, SIGMA, spread / np.outer(size, size)))
    body = np.array([3e-5] * 3 + [np.deg2rad(0.02)] * 3)
    marker = make_marker(
        source="jig",
        body_standard_uncertainty=body,
        led_standard_uncertainty=2e-5,
        centre_shift_standard_uncertainty=1e-5,
    )
    return stated_rig, marker


def drawn(rig: Rig, marker: Marker, rng: np.random.Generator) -> tuple[Rig, Marker]:
    """One true world about what is stated."""
    doubt = rig.covariance
    if doubt is None or marker.body_standard_uncertainty is None:
        return rig, marker
    root = np.linalg.cholesky(doubt.correlation)
    draw = doubt.standard_uncertainty * (root @ rng.normal(size=len(root)))
    cameras = []
    for camera, (fx, fy, cx, cy) in zip((rig.left, rig.right), draw[:8].reshape(2, 4), strict=True):
        change = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 0]])
        cameras.append(replace(camera, matrix=camera.matrix + change))
    mount, base = rig.right.mount.copy(), rig.rig_T_base.copy()
    mount[:3, :3] = turned(np.deg2rad(draw[8:11])) @ mount[:3, :3]
    base[:3, 3] += draw[11:14] * 1e-3
    base[:3, :3] = turned(np.deg2rad(draw[14:17])) @ base[:3, :3]
    body = marker.body_standard_uncertainty * rng.normal(size=6)
    leds = marker.leds @ turned(body[3:]).T + body[:3]
    for sigma in (marker.led_standard_uncertainty, marker.centre_shift_standard_uncertainty):
        leds = leds + (sigma or 0.0) * rng.normal(size=leds.shape)
    right = replace(cameras[1], mount=mount)
    return replace(rig, left=cameras[0], right=right, rig_T_base=base), replace(marker, leds=leds)


def turned(vector: Array) -> Array:
    matrix: Array = Rotation.from_rotvec(vector).as_matrix()
    return matrix


def replicate(rig: Rig, marker: Marker, parameters: Systematics, seed: int) -> Means:
    """A few visits of a healthy arm in one true world, measured with what is stated."""
    rng = np.random.default_rng(seed)
    true_rig, true_marker = drawn(rig, marker, rng)
    q = HOME + SPREAD * rng.uniform(-1, 1, (VISITS, 6))
    t = 5.0 * np.arange(VISITS)
    poses: Array = true_rig.rig_T_base @ robots.forward(ARM, q)
    measurements, effects = [], []
    for i in range(VISITS):
        true_pose: Array = poses[i]
        left, right = sight(true_rig, true_marker, true_pose, SPOT_SIGMA, rng)
        pose = fit_pose(left, right, rig, marker, true_pose)
        seen = Measurement(i, float(t[i]), "measured", len(marker), pose, left, right)
        measurements.append(seen)
        effects.append(sensitivities(parameters, seen, rig, marker))
    track = collect(measurements, rig, effects)
    log = (t[:, None] + np.linspace(-0.2, 0.2, 5)).ravel()
    comparison = compare(track, ARM, Readings(log, np.repeat(q, 5, axis=0)), 0.0)
    joints = solve_joints(comparison, ARM)
    model = build(comparison, track, rig, marker, GIVEN, parameters)
    systematic = joints.inverse @ model.prior_columns
    errors = JointErrors(joints.single, joints.covariance, systematic, np.zeros_like(joints.error))
    return mean_errors(model, errors, resolve(model), None, parameters)


@pytest.mark.parametrize("doubts", [False, True])
def test_d_squared_of_the_mean_errors_is_chi_squared(doubts: bool) -> None:
    rig, marker = believed(doubts=doubts)
    parameters = stated(rig, marker, turning=False)
    means = [replicate(rig, marker, parameters, seed) for seed in range(REPLICATES)]
    d2 = [float(m.mean @ np.linalg.solve(m.covariance, m.mean)) for m in means]
    degrees = 6 * REPLICATES
    low, high = chi2.ppf(0.005, degrees), chi2.ppf(0.995, degrees)
    assert low < sum(d2) < high
    z = np.array([m.mean / np.sqrt(np.diag(m.covariance)) for m in means])
    # six intervals of a replicate hold or miss together at worst: binomial of 40, three deviations
    assert np.mean(np.abs(z) < 1.96) > 0.95 - 3 * np.sqrt(0.95 * 0.05 / REPLICATES)
