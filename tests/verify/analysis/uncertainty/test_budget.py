"""The budget: its lines add up, its sensitivities are those of brute force and of other hands."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from msgspec.structs import replace as replaced
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import t as student

import robots
from robots.transforms import difference
from tests.support.beside import shared
from tests.support.motions import ARM, compared_session, make_track, read, swinging
from tests.support.scene import facing, make_marker, make_rig, sight
from tests.support.simulated import InMemory, in_memory, measured_at_spots
from verify import analyse, measure, open_session
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import (
    Comparison,
    ReadingUncertainty,
    compare,
    inflate_covariance,
    solve_joints,
)
from verify.analysis.diagnosis.diagnose import thin_model
from verify.analysis.joint_errors import (
    ResolvedErrors,
    error_terms,
    mean_sensitivities,
    resolve_errors,
)
from verify.analysis.measured import measure_pictures, session_clock
from verify.analysis.model import (
    JointErrorModel,
    add_pan_noise,
    build_model,
)
from verify.analysis.uncertainty.budget import Budget, budget
from verify.analysis.uncertainty.sources import axis_columns, robot_table_columns
from verify.core.readings import Readings
from verify.core.records import Array, Measurement, StereoPair
from verify.core.rig import Camera, Covariance
from verify.measurement.chain import Setup
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics
from verify.simulation import library
from verify.simulation.scenario import ScenarioFault

PAIRS = np.arange(1.0, 6.0, 1 / 10)
LOG = np.arange(0.0, 8.0, 0.02)
GIVEN = ClockEstimate(0.0, 5e-4, "given", np.zeros((0, 2)))
ESTIMATED = replace(GIVEN, source="estimated")
OPEN = ClockEstimate(0.0, None, "none", np.zeros((0, 2)))
NAMES = ("left.cx_px", "left.fx_px", "robot_base.x_mm", "robot_base.rz_deg", "body.z_mm")
SOURCES = ("rig", "rig", "robot base", "robot base", "LED body")
SIGMA = np.array([0.1, 0.2, 5e-5, 1e-4, 3e-5])  # SI
DEGREES = 7.0


@dataclass(frozen=True)
class Made:
    """A session as far as a budget asks for it."""

    model: JointErrorModel
    plain: Comparison
    resolved: ResolvedErrors
    found: Budget


def made(
    seed: int = 1,
    base: str = "fixture",
    body: str = "jig",
    clock: ClockEstimate = GIVEN,
    *,
    repeats: bool = False,
    tied: float = 0.0,
    pan: float = np.nan,
    rig_degrees: float = DEGREES,
    cause: float = 0.0,
    pairs: Array = PAIRS,
) -> Made:
    """A healthy arm swinging; rig and base tied by a correlation, pairs that repeat each other.

    `cause` is the size of a common cause, in the pairs' own noise.
    """
    rng = np.random.default_rng(seed)
    track = make_track(pairs, swinging(pairs), rng)
    n = len(track)
    columns = rng.normal(size=(1, 6, len(NAMES) + 2)) + 0.3 * rng.normal(
        size=(n, 6, len(NAMES) + 2)
    )
    columns *= np.array([1e-4, 1e-5, 1.0, 0.5, 1.0, 0.6, 0.6])
    track = replace(
        track, systematic=columns, pan=np.round(rng.uniform(0, 0.1, (n, 2)), 2),
        alignment_error=1e-5 * rng.normal(size=(1, 6)) * np.ones((n, 1)),
    )  # fmt: skip
    correlation = np.eye(len(NAMES))
    correlation[0, 2] = correlation[2, 0] = tied
    systematics = Systematics(
        NAMES, SOURCES, correlation * np.outer(SIGMA, SIGMA), np.array([pan, pan]), (),
        rig_degrees,
    )  # fmt: skip
    covariance = Covariance(NAMES[:4], np.ones(4), np.eye(4), rig_degrees)
    rig = replace(make_rig(), base_source=base, covariance=covariance)
    marker = replace(make_marker(), source=body)
    plain = add_pan_noise(
        compare(
            track, ARM, read(swinging, LOG, 0.0, rng), 0.0, stated=ReadingUncertainty(1e-4, 1e-4)
        ),
        track,
        systematics,
    )
    counted = (
        inflate_covariance(plain, np.array([1.0, 2.0, 1.0, 3.0, 1.0, 1.5])) if repeats else plain
    )
    model = build_model(counted, track, rig, marker, clock, systematics)
    compared = compared_session(
        track, plain, systematics, clock, rig=rig, marker=marker,
        encoder_resolution=1e-4, encoder_time_standard_uncertainty=1e-4,
    )  # fmt: skip
    resolved = resolve_errors(model)
    if cause:
        resolved = replace(resolved, common=cause * rng.normal(size=(len(model.xi), 1)))
    return Made(model, plain, resolved, budget(model, compared, resolved))


CASES: dict[str, dict[str, Any]] = {
    "plain means": {},
    "an estimated clock": {"clock": ESTIMATED},
    "pairs that repeat each other": {"repeats": True},
    "rig and base found together": {"tied": 0.8},
    "few pan readings": {"pan": 1e-4},
    "base through the encoders": {"base": "motion"},
    "base and LEDs through the encoders": {"base": "motion", "body": "motion", "repeats": True},
    "a clock that does not show": {"clock": OPEN},
}


@pytest.mark.parametrize("case", list(CASES))
def test_the_lines_add_up_to_the_stated_uncertainty(case: str) -> None:
    this = made(**CASES[case])
    lines = this.found.lines
    signed = lines["standard_uncertainty_deg"] * lines["standard_uncertainty_deg"].abs()
    total = signed.groupby(lines["joint"]).sum(min_count=1).to_numpy()
    stated = np.rad2deg(np.sqrt(np.diag(this.resolved.mean_covariance)))
    known = ~np.isnan(stated)
    assert known.any()
    assert_allclose(np.sqrt(total[known]), stated[known], rtol=1e-8)
    assert_allclose(lines.groupby("joint")["share"].sum().to_numpy()[known], 1, rtol=1e-8)


def test_every_source_that_is_stated_has_its_line_type_and_kind() -> None:
    lines = made(repeats=True, pan=1e-4).found.lines
    of = {row["source"]: (row["kind"], row["type"]) for row in lines.to_dict("records")}
    assert of == {
        "pixels": ("random", "A"),
        "readings' noise": ("random", "A"),
        "encoder resolution": ("random", "B"),
        "encoder time stamps": ("random", "B"),
        "autocorrelation": ("random", "A"),
        "rig": ("systematic", "B"),
        "robot base": ("systematic", "B"),
        "LED body": ("systematic", "B"),
        "clock": ("systematic", "B"),
        "alignment of the two instants": ("systematic", "B"),
        "pan angle": ("systematic", "B"),
    }


@pytest.mark.parametrize("case", ["plain means", "base through the encoders"])
def test_a_sensitivity_is_what_the_mean_does_when_the_parameter_is_moved(case: str) -> None:
    """Brute force: the poses are moved by a parameter, and the means are found anew."""
    this = made(**CASES[case])
    table = this.found.parameters.set_index(["parameter", "joint"])["sensitivity_deg"]
    for p, name in enumerate(NAMES):
        step = 1e-3 * SIGMA[p]
        moved = this.plain.systematic[:, :, p] * step
        shift = np.rad2deg(_mean_with(this, moved) - this.resolved.mean) / step
        scale = {"px": 1.0, "mm": 1e-3, "deg": np.pi / 180}[name.rsplit("_", 1)[-1]]
        known = ~np.isnan(shift)
        assert_allclose(table[name].to_numpy()[known], (shift * scale)[known], rtol=1e-5, atol=1e-9)


def _mean_with(this: Made, moved: Array) -> Array:
    """The means of the same session with the twists moved by (n, 6)."""
    comparison = replace(this.model.comparison, xi=this.model.comparison.xi + moved)
    white = this.model.white.rows(comparison.xi[:, :, None])[:, 0]
    return resolve_errors(replace(this.model, comparison=comparison, xi=white)).mean


@pytest.mark.parametrize("robot", ["iust_6r", "rv_3sd", "rv_3sd_melfa"])
def test_every_entry_of_the_table_moves_the_flange_as_another_table_does(robot: str) -> None:
    arm, h = robots.load(robot), 1e-6
    q = np.random.default_rng(6).uniform(-1.0, 1.0, (30, arm.dof))
    names, columns = robot_table_columns(arm, cast("Comparison", SimpleNamespace(q=q)))
    for name, column in zip(names, np.moveaxis(columns, 2, 0), strict=True):
        key, joint = name.partition("_")[0][:-1], int(name.partition("_")[0][-1]) - 1
        ahead, behind = (robots.forward(changed(arm, key, joint, s * h), q) for s in (1, -1))
        assert_allclose(column, difference(ahead, behind) / (2 * h), atol=1e-8)


def changed(arm: robots.DhArm, key: str, joint: int, step: float) -> robots.DhArm:
    entry = getattr(arm, key).copy()
    entry[joint] += step
    return replace(arm, **{key: entry})


def test_a_baseline_off_by_a_percent_moves_the_pairs_by_what_is_said() -> None:
    """Finite difference: the same spots, measured with a rig or a base that is off.

    Plain means: a cause that the search finds in such pairs takes it off the resolved errors.
    """
    sample = library.load("multi_joint_fault_6r")
    recording = replaced(sample.recording, skew_s=0.0, skew_jitter_s=0.0, pairs=30)
    session = in_memory(replaced(sample, recording=recording))
    means, unstated = _at_spots(session)
    said = {(effect["source"], effect["error"]): effect for effect in unstated}
    rig = session.rig
    wider = {
        side: replace(camera, pan_center=camera.pan_center * [1.01, 1.0, 1.0])
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    bases = np.tile(rig.rig_T_base, (3, 1, 1))
    bases[range(3), range(3), 3] += 1e-3
    for error, rigs in {
        ("rig", "a baseline off by 1 %"): [replace(rig, **wider)],
        ("robot base", "1 mm"): [replace(rig, rig_T_base=base) for base in bases],
    }.items():
        j = said[error]["joint"] - 1
        moved = [abs(_at_spots(replace(session, rig=off))[0][j] - means[j]) for off in rigs]
        assert max(moved) == pytest.approx(said[error]["moves_mean_error_deg"], rel=0.2), error


def test_a_base_that_stands_elsewhere_asks_after_its_axis() -> None:
    sample = library.load("multi_joint_fault_6r")
    recording = replaced(sample.recording, skew_s=0.0, skew_jitter_s=0.0, pairs=30)
    session = in_memory(replaced(sample, recording=recording))
    left = replace(session.rig.left, pan=session.rig.left.pan - 0.35)
    focal = Covariance(("left.fx_px",), np.ones(1), np.eye(1))
    _, there = _at_spots(replace(session, rig=replace(session.rig, covariance=focal)))
    moved = replace(session.rig, left=left, covariance=focal)
    _, elsewhere = _at_spots(replace(session, rig=moved))
    axes = [{effect["error"] for effect in said if effect["source"] == "pan axes"}
            for said in (there, elsewhere)]  # fmt: skip
    assert axes == [set(), {"an axis off by 1°", "a camera 10 mm off its axis"}]


@pytest.mark.parametrize("away", [0.0, 0.35])
def test_an_axis_that_is_off_moves_a_pose_as_a_refit_shows(away: float) -> None:
    """Where a rig was found another axis changes nothing: the camera stands where it stood."""
    rig, marker, truth = make_rig(), make_marker(), facing(0.04, -0.02, 0.6)
    views = sight(rig, marker, truth, 0.02, np.random.default_rng(1))
    left, right = (replace(c, pan=c.pan + away) for c in (rig.left, rig.right))
    rig = replace(rig, left=left, right=right)
    pose = fit_pose(*views, rig, marker, truth)
    seen = Measurement(0, 0.0, "measured", 4, pose, *views)

    def of(*names: str) -> Array:
        parameters = replace(stated_systematics(rig, marker, turning=False), names=names)
        return sensitivities(parameters, seen, rig, marker)[None, :, : len(names)]

    for (_, columns), change in zip(axis_columns(rig, of), (_tilted, _shifted), strict=True):
        rigs = [replace(rig, left=change(left, axis)) for axis in (0, 2)]
        rigs += [replace(rig, right=change(right, axis)) for axis in (0, 2)]
        fits = [fit_pose(*views, other, marker, truth) for other in rigs]
        base_R_rig = rig.rig_T_base[:3, :3].T
        twists = [difference(fit.rig_T_flange, pose.rig_T_flange).reshape(2, 3) for fit in fits]
        expected = np.array([(twist @ base_R_rig.T).ravel() for twist in twists]).T
        assert_allclose(columns[0] / 1000, expected, atol=1e-9 + 0.01 * np.abs(expected).max())


def _tilted(camera: Camera, axis: int) -> Camera:
    """Its base's axis 0.001° off about an axis of the rig, the camera where it was."""
    turn = Rotation.from_euler("xyz"[axis], 1e-3, degrees=True).as_matrix()
    tilted = replace(camera, pan_axis=turn @ camera.pan_axis)
    back = np.linalg.inv(replace(tilted, mount=np.eye(4)).rig_T_camera(camera.pan))
    return replace(tilted, mount=back @ camera.rig_T_camera(camera.pan))


def _shifted(camera: Camera, axis: int) -> Camera:
    """0.01 mm off its base's axis, the camera where it was."""
    mount = camera.mount.copy()
    mount[axis, 3] += 1e-5
    shifted = replace(camera, mount=mount)
    away = (shifted.rig_T_camera(camera.pan) - camera.rig_T_camera(camera.pan))[:3, 3]
    return replace(shifted, pan_center=camera.pan_center - away)


def _at_spots(session: InMemory) -> tuple[list[float], list[dict[str, Any]]]:
    """Plain mean errors and what is unstated, at spot level and with the same noise each time."""

    def measured(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        systematics = stated_systematics(session.rig, session.marker, turning=False)
        yield from measured_at_spots(session, systematics, np.random.default_rng(3))

    summary = analyse(session, chain=measured).summary
    means = [joint["plain_mean_error_deg"] for joint in summary["joints"]]
    return means, summary["budget"]["unstated"]


def test_degrees_of_freedom_by_welch_and_satterthwaite_and_student_below_fifty() -> None:
    """A rig known from few boards rules a mean; GUM G.4.1 by hand."""
    this = made(rig_degrees=1.0)
    lines = this.found.lines
    for j in (1, 4):
        mine = lines[lines["joint"] == j].set_index("source")["standard_uncertainty_deg"]
        rig = mine["rig"] ** 2 + mine["robot base"] ** 2  # one calibration found both
        own = mine["pixels"] ** 2 + mine["readings' noise"] ** 2
        total = float((mine**2).sum())
        fitted = sum(map(len, error_terms(this.model.comparison)[0]))
        degrees = total**2 / (rig**2 / 1 + own**2 / (6 * len(PAIRS) - fitted))
        assert_allclose(this.found.degrees[j - 1], degrees, rtol=1e-6)
        expected = 2.0 if degrees > 50 else student.ppf(0.97725, degrees)
        assert_allclose(this.found.coverage_factor[j - 1], expected)
    assert this.found.coverage_factor.max() > 2.02
    assert np.all(made(rig_degrees=np.inf).found.coverage_factor == 2.0)


def test_a_common_cause_is_known_by_the_degrees_of_freedom_of_the_session() -> None:
    """Its size is estimated from the same few pairs: GUM G.4.1 by hand, and Student's factor."""
    this = made(rig_degrees=np.inf, cause=3.0, pairs=PAIRS[::10])
    for j in range(1, 7):
        mine = this.found.lines[this.found.lines["joint"] == j].set_index("source")
        square = mine["standard_uncertainty_deg"] ** 2
        own = mine["degrees_of_freedom"]["pixels"]
        assert mine["degrees_of_freedom"]["causes found"] == own < 20
        shown = square[["pixels", "readings' noise", "causes found"]].sum()
        degrees = square.sum() ** 2 / (shown**2 / own)
        assert_allclose(this.found.degrees[j - 1], degrees, rtol=1e-6)
        expected = 2.0 if degrees > 50 else student.ppf(0.97725, degrees)
        assert_allclose(this.found.coverage_factor[j - 1], expected)


def test_what_averages_out_falls_with_the_pairs_and_the_rest_does_not() -> None:
    this = made()
    half = thin_model(this.model, np.arange(0, len(PAIRS), 2))
    few = np.linalg.norm(mean_sensitivities(half, resolve_errors(half)), axis=1)
    assert np.all(few > 1.2 * this.found.random)
    assert_allclose(
        this.found.random**2 + this.found.systematic**2,
        np.diag(this.resolved.mean_covariance),
        rtol=1e-9,
    )


@pytest.mark.shared
def test_sensitivities_to_the_table_are_those_of_metrology_md() -> None:
    """metrology.md section 4: on the plain mean of q3, 1 mm in a2 gives 0.76° and in d1 0.60°."""
    session = open_session(shared("sessions", "multi_joint_fault_6r"))
    track = measure_pictures(session, lambda _done, _total: None, measure).track
    readings = Readings(session.encoders.t, session.encoders.q)
    clock = session_clock(session, track, readings)
    comparison = compare(track, session.arm, readings, clock.offset)
    inverse = solve_joints(comparison, session.arm).inverse
    names, columns = robot_table_columns(cast("robots.DhArm", session.arm), comparison)
    plain = np.rad2deg(np.einsum("njk,nkp->jp", inverse, columns)) / len(comparison) * 1e-3
    third = dict(zip(names, np.abs(plain[2]), strict=True))
    assert third["a2_mm"] == pytest.approx(0.76, abs=0.01)
    assert third["d1_mm"] == pytest.approx(0.60, abs=0.01)


@pytest.mark.slow
@pytest.mark.shared
def test_the_quarter_circle_is_a_sweep_of_joint_1_and_shows_it_sound() -> None:
    results = analyse(open_session(shared("sessions", "quarter_circle_6r")))
    (sweep,) = results.summary["sweeps"]
    assert sweep["joint"] == 1
    assert sweep["span_deg"] > 90
    assert not sweep["both_directions"]
    assert sweep["hysteresis_deg"] is None
    assert abs(sweep["gain"]) < 3.5 * sweep["gain_standard_uncertainty"]
    assert not sweep["eccentricity_beyond_chance"]
    assert min(sweep["nonlinearity_p_value"], sweep["wobble_p_value"]) > 1e-3


def test_pairs_across_a_step_do_not_count_in_the_flange_s_mean() -> None:
    """Their weight is nothing, and one of them made the mean uncertain by centimetres."""
    plain = library.load("multi_joint_fault_6r")
    fault = ScenarioFault(joint=4, step_deg=1.0, step_t_s=2.0)
    at_once = replaced(plain.recording, skew_s=0.0, skew_jitter_s=0.0)  # nothing aligns the spots
    session = in_memory(replaced(plain, fault=[fault], recording=at_once))

    def chain(_pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        stated = stated_systematics(session.rig, session.marker, turning=False)
        yield from measured_at_spots(session, stated, np.random.default_rng(1))

    summary = analyse(session, chain=chain).summary
    assert [(cause["kind"], cause["joint"]) for cause in summary["diagnosis"]] == [("step", 4)]
    assert 0.0 < summary["position"]["expanded_uncertainty_mm"] < 2.0
