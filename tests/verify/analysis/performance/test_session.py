"""Repeated poses and paths found in a session, against what the arm truly did."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from reports import Results
from tests.support.command import SAMPLES
from tests.support.motions import ARM, SIGMA, swinging
from tests.support.posed import encoders_csv, poses_csv, write_posed
from tests.support.recorded import refusal
from tests.support.repeated_poses import (
    DWELL,
    MOVE,
    OFF,
    SERVO,
    Repeated,
    measured_poses,
    model_of,
    pose_visits,
    readings_of,
    repeated,
)
from verify.analysis.performance.entries import condition_deviations, performance_summary
from verify.analysis.performance.holds import HoldNoise
from verify.analysis.performance.indices import repeatability
from verify.analysis.performance.poses import assess_pose, subtract_noise
from verify.analysis.performance.session import Performance, performance
from verify.analysis.session import analyse
from verify.core.records import Array
from verify.io.session.keys import TimeInterval
from verify.io.session.session import open_session

CYCLES = 12
RUN = repeated(CYCLES)


def of(run: Repeated, t: Array, **more) -> Performance | str:
    readings = readings_of(run)
    return performance(model_of(run, t, readings), ARM, readings, 0.0, **more)


def followed(run: Repeated) -> Array:
    return np.arange(0.05, run.end, 0.2)


@pytest.fixture(scope="module")
def found() -> Performance:
    judged = of(RUN, followed(RUN))
    assert isinstance(judged, Performance)
    return judged


def test_poses_are_recognised_from_the_motion(found: Performance) -> None:
    assert [p.visits.name for p in found.poses] == ["P1", "P2", "P3", "P4", "P5"]
    assert [len(p.visits.t) for p in found.poses] == [CYCLES + 1] + [CYCLES] * 4
    assert not found.named


def test_accuracy_is_the_offset_that_was_put_in(found: Performance) -> None:
    true = float(np.linalg.norm(OFF))
    held = [p.accuracy.found.low <= true <= p.accuracy.found.high for p in found.poses]
    assert sum(held) >= 4  # of five 95 % intervals
    for pose in found.poses:
        np.testing.assert_allclose(pose.accuracy.mean, OFF, atol=4 * SIGMA[0] / np.sqrt(CYCLES))


def test_repeatability_is_that_of_the_stops(found: Performance) -> None:
    for pose, number in zip(found.poses, (0, 4, 3, 2, 1), strict=True):
        true = float(repeatability(RUN.places(number)))
        visits = len(pose.visits.t)
        # six pairs a visit; by how much their noise moves the mean and three deviations of l
        noise = SIGMA[0] / np.sqrt(6) * np.sqrt(1 / visits + 9 / (visits - 1))
        assert pose.repeatability.found.value == pytest.approx(true, abs=4 * noise)
        assert pose.repeatability.robot == pytest.approx(true, abs=4 * noise)
        assert pose.repeatability.floor < 0.2 * true


def test_the_noise_is_that_of_the_holds(found: Performance) -> None:
    assert found.noise.source == "holds"
    np.testing.assert_allclose(np.sqrt(np.diag(found.noise.position)), SIGMA[0], rtol=0.12)
    np.testing.assert_allclose(np.sqrt(np.diag(found.noise.turn)), SIGMA[1], rtol=0.12)
    assert found.noise.together < 1.3  # white noise was put in


def test_an_arm_that_repeats_exactly_shows_the_floor_alone() -> None:
    exact = repeated(CYCLES, servo=0.0)
    shares = [p.repeatability for p in of(exact, followed(exact)).poses]
    assert sum(np.isnan(one.robot) for one in shares) >= 4  # at 95 %, as it should be
    assert all(one.robot_at_most < 2 * one.floor for one in shares)
    for one in shares:
        assert one.floor == pytest.approx(one.found.value, rel=0.45)  # 12 visits, 15 % each way


def test_orientations_repeat_as_the_joints_do(found: Performance) -> None:
    for pose in found.poses:
        assert all(one.low <= 0 <= one.high or abs(one.value) < 1e-4 for one in pose.angle_accuracy)
        spread = [np.rad2deg(one.found.value) for one in pose.angle_repeatability]
        assert 0.02 < min(spread) < max(spread) < 0.25  # 3 x 0.02° of six joints, in three axes


def test_distances_hold_no_offset(found: Performance) -> None:
    assert len(found.distances) == 10
    held = [d.accuracy.low <= 0 <= d.accuracy.high for d in found.distances]
    assert sum(held) >= 8


def test_no_drift_is_no_sign_of_drift(found: Performance) -> None:
    drifts = [p.drift for p in found.poses]
    assert all(d is not None and d.blocks == 2 for d in drifts)
    assert sum(d.accuracy <= d.noise[0] for d in drifts if d is not None) >= 4


def test_paths_are_recognised_and_off_by_what_lies_across_them(found: Performance) -> None:
    assert [p.name for p in found.paths] == ["P1 → P2", "P2 → P3", "P3 → P4", "P4 → P5", "P5 → P1"]
    for path in found.paths:
        assert path.passages == CYCLES
        tangent = path.crossings.tangent
        across = OFF - (tangent @ OFF)[:, None] * tangent
        true = float(np.linalg.norm(across, axis=1).max())
        assert path.accuracy.found.value == pytest.approx(true, abs=6e-5)
        assert path.accuracy_noise < 6e-5


STILL = HoldNoise(np.eye(3) * 1e-12, np.eye(3) * 1e-14, 1.0, "holds", 100)


def test_a_pose_approached_from_two_sides_varies_by_the_backlash() -> None:
    rng = np.random.default_rng(4)
    came = (1, 2) * 15
    lash = np.where(np.array(came) == 1, 1e-4, -1e-4)[:, None] * [0.6, 0.0, 0.8]
    judged = assess_pose(
        pose_visits(lash + rng.normal(0, 2e-5, (30, 3)), came), STILL, oriented=True
    )
    assert judged.variation.ways == 2
    assert judged.variation.position.low <= 2e-4 <= judged.variation.position.high
    assert judged.variation.noise < 4e-5


def test_a_variation_is_judged_where_deviations_lie_on_one_line_whichever_way_it_points() -> None:
    length = np.where(np.arange(8) % 3 == 1, 1e-4, 0.0)[:, None]  # an instrument's last digit
    found = []
    for line in ([1.0, 0.0, 0.0], [0.6, 0.8, 0.0], [1 / 3, 2 / 3, 2 / 3]):
        judged = assess_pose(pose_visits(length * line, (1, 2) * 4), STILL, oriented=False)
        assert judged.variation is not None
        found.append((judged.variation.position.value, judged.variation.noise))
    np.testing.assert_allclose(found, found[:1] * 3, rtol=0.1)  # drawn anew along each line


@pytest.mark.slow
def test_scatter_is_distinguished_from_a_variation() -> None:
    over = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        judged = assess_pose(
            pose_visits(rng.normal(0, 2e-5, (20, 3)), (1, 2) * 10), STILL, oriented=False
        )
        over.append(judged.variation.position.value > judged.variation.noise)
    assert 1 <= sum(over) <= 13  # 5 in 100: the 99.9 % binomial bounds


def test_a_step_half_way_is_drift() -> None:
    rng = np.random.default_rng(5)
    step = np.repeat([0.0, 3e-4], 15)[:, None] * [1.0, 0.0, 0.0]
    judged = assess_pose(pose_visits(step + rng.normal(0, 5e-5, (30, 3))), STILL, oriented=False)
    assert judged.drift.accuracy > judged.drift.noise[0]
    assert judged.drift.accuracy == pytest.approx(3e-4, abs=8e-5)


def test_three_visits_are_too_few_and_a_swing_has_none() -> None:
    short = repeated(3)
    assert of(short, followed(short)) == "no_repeats"
    moving = Repeated((0,), np.zeros((1, 6)))
    object.__setattr__(moving, "joints", swinging)
    t = np.arange(0.0, 6.0, 0.2)
    assert of(moving, t) == "no_holds"


def test_single_visits_take_the_noise_that_the_poses_state() -> None:
    t = np.arange(len(RUN.order)) * 2.2 + 0.6  # one pair a stop, 2.2 s apart
    judged = of(RUN, t)
    assert judged.noise.source == "stated"
    assert [len(p.visits.t) for p in judged.poses] == [CYCLES + 1] + [CYCLES] * 4
    assert judged.paths == ()


def test_incomplete_pairs_are_left_out() -> None:
    readings = readings_of(RUN)
    model = model_of(RUN, followed(RUN), readings)
    known = list(model.comparison.determined)
    known[::2] = [np.eye(6)[:, :5]] * len(known[::2])
    model.comparison = replace(model.comparison, determined=tuple(known))
    judged = performance(model, ARM, readings, 0.0)
    assert [len(p.visits.t) for p in judged.poses] == [CYCLES + 1] + [CYCLES] * 4
    assert sum(p.visits.counts.sum() for p in judged.poses) < 0.6 * len(known)
    model.comparison = replace(model.comparison, determined=(np.eye(6)[:, :5],) * len(known))
    assert performance(model, ARM, readings, 0.0) == "poses_not_determined"


def test_a_doubtful_base_is_in_accuracy_and_in_no_distance() -> None:
    """0.1 mm along x and 0.05° about z of the robot's place: rigid, so distances keep theirs."""
    readings = readings_of(RUN)
    model = model_of(RUN, followed(RUN), readings)
    places = model.comparison.base_T_measured[:, :3, 3]
    doubt = np.zeros((len(places), 6, 2))
    doubt[:, 0, 0] = 1e-4
    doubt[:, 5, 1] = np.deg2rad(0.05)
    doubt[:, :3, 1] = np.cross([0.0, 0.0, np.deg2rad(0.05)], places)
    model.prior_columns = doubt
    judged = performance(model, ARM, readings, 0.0)
    sure = of(RUN, followed(RUN))
    for pose in judged.poses:
        about_z = np.linalg.norm(pose.commanded[:2, 3]) * np.deg2rad(0.05)
        assert 0 < pose.accuracy.expanded_uncertainty < 2.1 * np.hypot(1e-4, about_z)
        assert pose.accuracy.noise > 8e-5
    for with_doubt, without in zip(judged.distances, sure.distances, strict=True):
        assert with_doubt.accuracy.high == pytest.approx(without.accuracy.high, abs=2e-6)
    listed = condition_deviations(judged, temperature_c=20.0, through_encoders=False)
    doubtful = next(d for d in listed if d["kind"] == "uncertainty")
    assert doubtful["smallest_mm"] > 0.37  # what was put in cannot be certified with such a base


def test_named_poses_alone_count() -> None:
    stops = [i for i, pose in enumerate(RUN.order) if pose == 2]
    named = [TimeInterval("upper left", 2.2 * i, 2.2 * i + 1.2) for i in stops]
    nowhere = TimeInterval("elsewhere", 5000.0, 5001.0)
    judged = of(RUN, followed(RUN), named_poses=[*named, nowhere])
    assert judged.named
    assert [(p.visits.name, len(p.visits.t)) for p in judged.poses] == [("upper left", CYCLES)]
    assert judged.empty == (nowhere,)


def test_named_paths_are_passages() -> None:
    stops = [i for i, pose in enumerate(RUN.order) if pose == 2]
    named = [TimeInterval("the long way", 2.2 * i + 1.0, 2.2 * i + 2.4) for i in stops]
    judged = of(RUN, followed(RUN), named_paths=named)
    assert [(p.name, p.passages) for p in judged.paths] == [("the long way", CYCLES)]


def test_what_differs_from_the_standard_is_listed(found: Performance) -> None:
    kinds = {
        d["kind"] for d in condition_deviations(found, temperature_c=25.5, through_encoders=True)
    }
    assert kinds == {
        "cycles", "plane", "drift", "registration", "commanded", "temperature", "load", "speed",
        "warm_up", "settling", "cube", "flange",
    }  # fmt: skip
    known = condition_deviations(found, temperature_c=20.5, through_encoders=False)
    assert not {"temperature", "temperature_unknown", "registration"} & {d["kind"] for d in known}


STATED = "position_standard_uncertainty_mm = 0.05\n"
TURNS = "orientation_standard_uncertainty_deg = 0.02\n"
POINT = "point_mm = [40.0, 0.0, 10.0]\n"


def written(folder: Path, *, more: str = "", positions_alone: bool = False) -> Path:
    run = repeated(6)
    t, readings = followed(run), readings_of(run)
    poses = poses_csv(t, measured_poses(run, t), positions_alone=positions_alone)
    stated = STATED + (POINT if positions_alone else TURNS)
    stated += f"[clock]\nencoder_offset_s = 0.0\n{more}\n"
    like, encoders = SAMPLES / "multi_joint_fault_6r", encoders_csv(readings.t, readings.q)
    return write_posed(folder, like, poses, frame="robot_base", more=stated, encoders=encoders)


def test_a_session_carries_its_repeated_poses(tmp_path: Path) -> None:
    results = analyse(open_session(written(tmp_path / "session")))
    entry = results.summary["performance"]
    assert results.summary["performance_reason"] is None
    assert entry["style"] == "ISO 9283-style"
    assert [p["visits"] for p in entry["poses"]] == [7, 6, 6, 6, 6]
    assert all(0.25 < p["ap_mm"] < 0.45 for p in entry["poses"])  # |OFF| is 0.374 mm
    assert len(results.tables["performance_poses"]) == 31
    assert set(results.tables["performance_paths"]["path"]) == {p["path"] for p in entry["paths"]}
    assert {d["kind"] for d in entry["deviations"]} >= {"cycles", "commanded", "load"}


@pytest.mark.slow
def test_positions_alone_are_judged_at_their_point(tmp_path: Path) -> None:
    folder = written(tmp_path / "session", positions_alone=True)
    entry = analyse(open_session(folder)).summary["performance"]
    assert entry["point_mm"] == [40.0, 0.0, 10.0]
    assert len(entry["poses"]) == 5
    assert all("ap_rx_deg" not in pose for pose in entry["poses"])
    assert entry["noise_floor"]["rotation_deg"] is None


@pytest.mark.parametrize(
    ("more", "place", "found"),
    [
        ('[[pose]]\nname = ""\nt_start_s = 1.0\nt_end_s = 2.0', "pose[0].name", "is empty"),
        ('[[pose]]\nname = "A"\nt_start_s = 1.0\nt_end_s = 1.0', "pose[0].t_end_s", "is 1.0"),
        ('[[path]]\nname = "A"\nt_start_s = 1.0', "path[0].t_end_s", "is missing"),
    ],
)
def test_a_wrong_name_is_refused(tmp_path: Path, more: str, place: str, found: str) -> None:
    message = str(refusal(open_session, written(tmp_path / "session", more=more)))
    assert place in message
    assert found in message


def test_a_sessions_named_poses_count_and_a_misspelt_key_is_warned_of(tmp_path: Path) -> None:
    stops = [i for i, pose in enumerate(repeated(6).order) if pose == 0]
    more = "\n".join(
        f'[[pose]]\nname = "home"\nt_start_s = {2.2 * i:.1f}\nt_end_s = {2.2 * i + 1.2:.1f}\n'
        f"{'note = 1' if i == 0 else ''}"
        for i in stops
    )
    session = open_session(written(tmp_path / "session", more=more))
    assert any("pose[0].note" in warning for warning in session.warnings)
    entry = analyse(session).summary["performance"]
    assert entry["recognised"] == "named"
    assert [(p["pose"], p["visits"]) for p in entry["poses"]] == [("home", 7)]


def test_a_floor_that_is_stated_too_high_bounds_no_robot_below_what_it_shows(
    found: Performance,
) -> None:
    shown = found.poses[0].repeatability.found
    for floor in (shown.high, 3 * shown.high):
        share = subtract_noise(shown, floor)
        assert np.isnan(share.robot)
        assert share.robot_at_most > 0.8 * shown.value


def test_drift_of_visits_without_times_has_no_duration() -> None:
    untimed = of(RUN, followed(RUN), timed=False)
    assert isinstance(untimed, Performance)
    listed = condition_deviations(untimed, temperature_c=20.0, through_encoders=False)
    assert {"kind": "drift", "found_s": None} in listed
    drifts = [p["drift"] for p in performance_summary(untimed, [])["poses"]]
    assert drifts
    assert all(d["duration_s"] is None for d in drifts)


def visited(
    folder: Path, change: Callable[[Array], None], *, stated: bool = True, cycles: int = 6
) -> Results:
    """A session of single visits without times, its poses (n, 4, 4) changed in place."""
    run = repeated(cycles, servo=SERVO / 4)
    t = np.arange(len(run.order)) * (DWELL + MOVE)
    poses = measured_poses(run, t)
    change(poses)
    without = [
        "".join(line.partition(",")[2] for line in text.splitlines(keepends=True))
        for text in (poses_csv(t, poses), encoders_csv(t, run.joints(t)))
    ]
    like, more = SAMPLES / "multi_joint_fault_6r", (STATED + TURNS) * stated
    write_posed(folder, like, without[0], frame="robot_base", more=more, encoders=without[1])
    return analyse(open_session(folder))


def test_a_pose_that_the_instrument_repeats_is_left_out(tmp_path: Path) -> None:
    def stale(poses: Array) -> None:
        poses[10:15] = poses[9]  # the last one stands where that was measured

    summary = visited(tmp_path / "session", stale).summary
    assert summary["pairs"]["rejected"] == {"unaligned": 5}
    assert any("5 of 31 poses repeat an earlier one" in w for w in summary["warnings"])
    poses = summary["performance"]["poses"]
    assert sum(p["visits"] for p in poses) == 26
    assert all(p["rp_mm"] < 0.5 for p in poses)  # with them: 160 mm


def test_a_coarse_instrument_at_rest_repeats_no_pose(tmp_path: Path) -> None:
    def coarse(poses: Array) -> None:
        poses[:, :3, 3] = np.round(poses[:, :3, 3], 3)

    summary = visited(tmp_path / "session", coarse).summary
    assert summary["pairs"]["measured"] == 31


def test_a_visit_far_off_the_others_is_named_beside_the_figure(tmp_path: Path) -> None:
    def gross(poses: Array) -> None:
        poses[10, :3, 3] += [0.0, 0.005, 0.0]

    summary = visited(tmp_path / "session", gross).summary
    (named,) = summary["performance"]["outlying_visits"]
    assert (named["pose"], named["visits"], named["pairs"]) == ("P1", [3], [10])
    assert named["off_mm"] == pytest.approx(5.0, abs=0.2)
    assert named["rp_without_mm"] < 0.5 < summary["performance"]["poses"][0]["rp_mm"]
    (warning,) = [w for w in summary["warnings"] if "Outlying among" in w]
    assert "P1: 3 (pairs 10), up to 5" in warning
    assert "without them RP = 0." in warning


def test_visits_that_only_scatter_are_not_named(found: Performance) -> None:
    assert performance_summary(found, [])["outlying_visits"] == []
    assert not len(found.left_out)


@pytest.mark.parametrize("pairs", [1, 2])
def test_pairs_far_off_the_others_of_their_hold_are_left_out(
    found: Performance, pairs: int
) -> None:
    readings, t = readings_of(RUN), followed(RUN)
    model = model_of(RUN, t, readings)
    rows = np.searchsorted(t, 20 * (DWELL + MOVE)) + 1 + np.arange(pairs)
    model.comparison.base_T_measured[rows, 0, 3] += 0.005
    judged = performance(model, ARM, readings, 0.0)
    assert judged.left_out.tolist() == rows.tolist()
    assert performance_summary(judged, [])["outlying_visits"] == []
    sigma, before = (np.sqrt(np.diag(one.noise.position)) for one in (judged, found))
    np.testing.assert_allclose(sigma, before, rtol=0.1)
    for one, plain in zip(judged.poses, found.poses, strict=True):
        after = one.repeatability.found.value
        assert after == pytest.approx(plain.repeatability.found.value, rel=0.1)


def test_where_the_arm_came_from_is_unknown_after_a_visit_that_was_lost() -> None:
    t = followed(RUN)
    stop = t // (DWELL + MOVE)
    judged = of(RUN, t[stop != 7])
    came = {p.visits.name: p.visits.came_from for p in judged.poses}
    assert came["P4"] == (2, -1, *[2] * (CYCLES - 2))  # stop 7, of P3, was lost
    assert of(RUN, t).poses[3].visits.came_from == (2,) * CYCLES


def test_the_noise_of_single_visits_is_not_that_of_one_gross_pose(tmp_path: Path) -> None:
    def gross(poses: Array) -> None:
        poses[10, :3, 3] += [0.0, 0.005, 0.0]

    noise = visited(tmp_path / "session", gross, stated=False).summary["performance"]["noise_floor"]
    assert max(noise["position_mm"]) < 2 * 1e3 * SIGMA[0]  # with it: 0.5 mm
