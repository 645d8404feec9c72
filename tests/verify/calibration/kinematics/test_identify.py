"""What is identified is true, within what is stated, and no more is claimed than can be known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from robots.transforms import difference
from tests.support.true_arm import TrueArm, measured, readings, true_arm
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.identifiability import observability_indices
from verify.calibration.kinematics.identify import (
    IdentificationOptions,
    IdentificationResult,
    identify_arm,
)
from verify.calibration.kinematics.model import predict_with_jacobian
from verify.calibration.kinematics.poses import build_poses
from verify.core.records import Array

RUNS = 8
GEOMETRY = IdentificationOptions(level="geometry", splits=0)
THREE_SPLITS = IdentificationOptions(splits=3)


def identify(
    truth: TrueArm, *measurements: Array, wish: IdentificationOptions = GEOMETRY, **more: Array
) -> IdentificationResult:
    """Identify from readings (n, 6), what was seen at them and, if given, its covariance."""
    return identify_arm(chain_of(truth.arm), replace(build_poses(*measurements), **more), wish)


def identified(
    truth: TrueArm, count: int, seed: int, wish: IdentificationOptions = GEOMETRY
) -> IdentificationResult:
    q = readings(truth.arm, count, seed)
    return identify(truth, q, *measured(truth, q, seed + 1), wish=wish)


def predicted_less_true(found: IdentificationResult, truth: TrueArm, q: np.ndarray) -> float:
    """Mahalanobis length of the identified combinations' error, seen in predictions elsewhere."""
    fit = found.chosen.fit
    none = np.zeros(len(q), dtype=np.int64)
    placed, columns = predict_with_jacobian(fit.state, q, none, none, fit.parameters)
    off = difference(placed, truth.pose(q)).reshape(-1)
    design = columns.reshape(len(off), -1)
    error = np.linalg.lstsq(design, off, rcond=None)[0]
    # the identified parameters account for all of the error: what they hold back is no error
    assert np.linalg.norm(off - design @ error) < 0.05 * np.linalg.norm(off)
    return float(error @ np.linalg.solve(fit.covariance, error))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd_melfa"])
def test_predictions_meet_the_true_arm_within_the_stated_uncertainty(name: str) -> None:
    """d² of the 30 identified combinations over 8 arms, in the 99.8 % interval of χ²(240)."""
    total = 0.0
    for run in range(RUNS):
        truth = true_arm(name, seed=100 + run)
        found = identified(truth, 60, 200 + 10 * run)
        assert len(found.chosen.support.supported) == found.chosen.support.rank == 30
        total += predicted_less_true(found, truth, readings(truth.arm, 40, 300 + run))
    low, high = chi2.ppf([0.001, 0.999], 30 * RUNS)
    assert low < total < high


def test_errors_of_geometry_are_called_for_and_carry_over_to_poses_held_out() -> None:
    found = identified(true_arm("iust_6r", seed=1), 80, 2, THREE_SPLITS)
    assert found.chosen.name == "geometry"
    before, after = (found.level(n).held_out for n in ("registration", "geometry"))
    assert before.position[0] > 1e-3
    assert after.position[0] < 3e-4  # noise of 0.16 mm in three directions, and the model's own


def test_a_healthy_arm_is_left_as_it_is() -> None:
    found = identified(true_arm("iust_6r", seed=3, geometry=0.0, offsets=0.0), 60, 4, THREE_SPLITS)
    assert found.chosen.name == "registration"
    assert not found.chain.correction.any()


def test_a_handful_of_poses_calls_for_no_geometry() -> None:
    """6 poses are 36 numbers: 29 parameters would fit them, and mean nothing."""
    assert identified(true_arm("iust_6r", seed=1), 6, 2, THREE_SPLITS).chosen.name != "geometry"


def test_offsets_are_distinguished_from_geometry_with_the_sign_to_add() -> None:
    truth = true_arm("rv_3sd_melfa", seed=5, geometry=0.0)
    found = identified(truth, 60, 6, THREE_SPLITS)
    assert found.chosen.name == "offsets"
    fit = found.chosen.fit
    each = zip(fit.parameters, fit.change, np.sqrt(np.diag(fit.covariance)), strict=True)
    for parameter, value, u in each:
        if parameter.kind == "correction":
            assert abs(value - truth.correction[parameter.place]) < 4 * u, parameter.name


def test_what_base_and_tool_take_in_is_named() -> None:
    """Metrology's gauges: base with joint 1's offset and d, tool with joint 6's four; two d's."""
    found = identified(true_arm("iust_6r", seed=7), 40, 8, IdentificationOptions(splits=0))
    held = {h.parameter.name: h for h in found.level("geometry").support.held}
    assert set(held) == {
        "offset_1", "d_1", "offset_6", "d_6", "a_6", "alpha_6", "d_2", "d_3",
    }  # fmt: skip
    assert all(h.redundant for h in held.values())
    alpha = held.pop("alpha_6")
    assert all(parameter.kind == "tool" for parameter, _ in alpha.confounded_with)
    assert {name: entry.confounded_with[0][0].name for name, entry in held.items()} == {
        "offset_1": "base_rz", "d_1": "base_z", "offset_6": "tool_rz", "d_6": "tool_z",
        "a_6": "tool_x", "d_2": "d_4", "d_3": "d_4",
    }  # fmt: skip


def test_positions_of_a_point_support_27_parameters() -> None:
    truth = true_arm("iust_6r", seed=9)
    q = readings(truth.arm, 80, 10)
    seen, covariance = measured(truth, q, 11)
    wish = IdentificationOptions(splits=2, level="geometry")
    found = identify(truth, q, seen[:, :3, 3], covariance[:, :3, :3], wish=wish)
    assert found.chosen.support.rank == len(found.chosen.support.supported) == 27
    assert found.chosen.held_out.position[0] < 3e-4
    assert np.isnan(found.chosen.held_out.orientation).all()
    wide = {p.kind: p.prior / p.tolerance for p in found.chosen.fit.parameters}
    assert wide["correction"] == 3  # of lengths and twists what they were drawn with, 0.3
    for kinds in (("a", "d"), ("alpha", "beta")):
        n = sum(p.kind in kinds for p in found.chosen.fit.parameters)
        assert 0.2 < wide[kinds[0]] * np.sqrt((n - 2) / n) < 0.45  # wider, by Student's


def test_noise_that_is_not_stated_is_found() -> None:
    truth = true_arm("iust_6r", seed=12)
    q = readings(truth.arm, 200, 13)
    scale = identify(truth, q, measured(truth, q, 14)[0]).chosen.fit.scale
    assert scale.position == pytest.approx(1e-4, rel=0.15)
    assert np.degrees(scale.orientation) == pytest.approx(0.05, rel=0.15)


def test_never_more_than_a_tenth_is_left_out_and_doubt_grows_instead() -> None:
    """A fifth of the poses is off by 3 mm; noise of 0.1 mm is stated."""
    truth = true_arm("iust_6r", seed=15)
    q = readings(truth.arm, 60, 16)
    seen, covariance = measured(truth, q, 17)
    seen[::5, :3, 3] += np.random.default_rng(1).normal(0, 3e-3, (12, 3))
    fit = identify(truth, q, seen, covariance).chosen.fit
    assert (~fit.used).sum() == 6
    assert set(np.flatnonzero(~fit.used)) <= set(range(0, 60, 5))
    assert fit.scale.position > 3


def test_outlying_poses_are_listed_and_do_no_harm() -> None:
    truth = true_arm("iust_6r", seed=15)
    q = readings(truth.arm, 60, 16)
    seen, covariance = measured(truth, q, 17)
    for row, by in ((5, 3e-3), (17, 20e-3), (40, 0.5)):
        seen[row, :3, 3] += by
    found = identify(truth, q, seen, covariance)
    assert np.flatnonzero(~found.chosen.fit.used).tolist() == [5, 17, 40]
    assert predicted_less_true(found, truth, readings(truth.arm, 40, 18)) < chi2.ppf(0.999, 30)


def test_little_motion_leaves_parameters_to_their_priors() -> None:
    """±2° about one posture: base, tool and arm trade degrees, and each says so."""
    truth = true_arm("iust_6r", seed=19, geometry=0.0, offsets=0.0)
    q = np.radians([10.0, -60, 80, 30, 50, 20]) + np.random.default_rng(20).uniform(
        -0.035, 0.035, (30, 6)
    )
    found = identify(truth, q, *measured(truth, q, 21))
    assert found.chosen.support.rank == 30
    weak = found.chosen.weak
    assert {"d_4", "a_2"} <= {w.parameter.name for w in weak}
    assert all(w.uncertainty_if_free > w.parameter.prior / 2 and w.confounded_with for w in weak)
    fit = found.chosen.fit
    for parameter, u in zip(fit.parameters, fit.standard_uncertainty, strict=True):
        assert parameter.axis or u <= parameter.prior


def test_two_placings_of_one_arm_share_its_parameters() -> None:
    truth = true_arm("iust_6r", seed=22)
    other = true_arm("iust_6r", seed=23)
    q = readings(truth.arm, 80, 24)
    seen, covariance = measured(truth, q, 25)
    # the same arm in another place: only where its base stands changes
    shift = other.world_T_base @ np.linalg.inv(truth.world_T_base)
    seen[40:] = shift @ seen[40:]
    found = identify(truth, q, seen, covariance, base=np.repeat([0, 1], 40))
    assert found.chosen.support.rank == 36
    first, second = found.chosen.fit.state.base
    assert np.allclose(difference(second[None], (shift @ first)[None]), 0.0, atol=1e-3)


def test_the_indexes_are_their_definitions() -> None:
    """By hand, for singular values 4, 2 and 1 and four poses."""
    assert observability_indices(np.diag([1.0, 4.0, 2.0]), 4) == pytest.approx(
        {"O1": 1.0, "O2": 0.25, "O3": 1.0, "O4": 0.25, "O5": 1 / 1.75}
    )


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="another shape"):
        build_poses(np.zeros((5, 6)), np.zeros((5, 3)), np.zeros((5, 6, 6)))
