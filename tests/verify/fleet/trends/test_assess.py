"""Steps and drifts are found, dated and distinguished; a fleet without change has none."""

import re
from datetime import date
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from reports.fleet.certificate import several_arms
from reports.results import Results
from tests.support.fleets import BEGIN, NO_FAILURES, rows
from verify.errors import InputError
from verify.fleet.trends.assess import P_FALSE_ALARM, TrendRequest, assess, require_folders
from verify.fleet.trends.changes import candidates, find_changes
from verify.fleet.trends.joints import assess_joint
from verify.fleet.trends.series import (
    DAYS_PER_MONTH,
    JointSeries,
    _with_excess,
    apply_inverse_covariance,
    contrast,
    fit,
    scan,
    series_of,
)


def assessed(sessions: pd.DataFrame, **request: Any) -> Results:
    return assess(sessions, NO_FAILURES, TrendRequest(**request), ())


def changes(sessions: pd.DataFrame) -> pd.DataFrame:
    return assessed(sessions).table("changes")


def dense(series: JointSeries) -> np.ndarray:
    alike = series.group[:, None] == series.group
    shared = {g: np.mean(series.shared[series.group == g] ** 2) for g in set(series.group)}
    blocks = np.array([[shared[g] for _ in series.group] for g in series.group])
    return np.diag(series.scatter**2) + np.where(alike, blocks, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("calibrations", [1, 3])
def test_only_the_drifting_and_the_stepping_joint_are_found(calibrations: int) -> None:
    sessions = rows(1, drift=0.02, step=0.3, calibrations=calibrations)
    found = changes(sessions)
    assert [(r.arm, r.joint, r.kind) for r in found.itertuples()] == [
        ("arm_a", 3, "drift"),
        ("arm_b", 5, "step"),
    ]
    drift, step = found.to_dict("records")
    assert abs(drift["size"] - 0.02) < 3 * drift["size_u"] < 0.01
    assert drift["unit"] == "deg/month"
    assert abs(step["size"] - 0.3) < 3 * step["size_u"] < 0.05
    arm = sessions[sessions["robot"] == "arm_b"]
    later = arm[arm["started"] >= pd.Timestamp(BEGIN) + pd.Timedelta(days=160)]
    assert step["session"] == later.iloc[0]["session"]
    first = sessions[sessions["robot"] == "arm_a"].iloc[0]["session"]
    assert drift["session"] == first


@pytest.mark.slow
def test_a_fleet_without_change_has_no_findings() -> None:
    fleets = [rows(1000 + seed, sessions=30, calibrations=seed % 3 + 1) for seed in range(16)]
    accused = sum(len(changes(fleet)) > 0 for fleet in fleets)
    assert accused <= stats.binom.isf(0.001, len(fleets), P_FALSE_ALARM)
    # nor where sessions scatter more than they state
    results = [assessed(rows(2000 + seed, sessions=30, scatter=2.5)) for seed in range(12)]
    assert sum(len(r.table("changes")) > 0 for r in results) <= 1
    excess = np.concatenate([r.table("joints")["excess"] for r in results])
    assert np.median(excess) == pytest.approx(2.5, rel=0.15)


def test_a_drift_ended_by_a_repair_is_drift_and_step() -> None:
    sessions = rows(5, sessions=120)
    arm = sessions["robot"] == "arm_c"
    day = (sessions["started"] - pd.Timestamp(BEGIN)).dt.total_seconds() / 86_400
    sessions.loc[arm, "q2_mean_error_deg"] += np.where(day < 200, 0.1 * day / 30.44, 0.0)[arm]
    found = changes(sessions)
    assert set(found["arm"]) == {"arm_c"}
    assert set(found["joint"]) == {2}
    assert set(found["term"]) == {"drift", "step"}
    repaired = sessions[arm & (day >= 200)].iloc[0]["session"]
    assert found[found["term"] == "step"].iloc[0]["session"] == repaired


def monthly(errors: np.ndarray, seed: int, u: float = 0.004) -> pd.DataFrame:
    """Sessions of one arm, a month apart; joint 5 has these errors (n,), degrees."""
    sessions = rows(seed, sessions=len(errors), shared=0.002).query("robot == 'arm_a'").copy()
    sessions["started"] = pd.Timestamp(BEGIN) + pd.to_timedelta(30.44 * np.arange(len(errors)), "D")
    noise = np.random.default_rng(seed).normal(0, u, len(errors))
    sessions["q5_mean_error_deg"] = errors + noise
    sessions["q5_session_uncertainty_deg"] = u
    sessions["q5_standard_uncertainty_deg"] = np.hypot(u, 0.002)
    return sessions


@pytest.mark.parametrize("sessions", [8, 14])
@pytest.mark.parametrize("drift", [0.012, 0.03, 0.2])
def test_a_steady_drift_over_few_sessions_is_no_scatter(sessions: int, drift: float) -> None:
    results = assessed(monthly(drift * np.arange(sessions), seed=20))
    found = results.table("changes")
    assert [(r.joint, r.kind, r.unit) for r in found.itertuples()] == [(5, "drift", "deg/month")]
    assert abs(found["size"].iloc[0] - drift) < 3 * found["size_u"].iloc[0]
    joint = results.table("joints").set_index("joint").loc[5]
    assert (joint["state"], joint["odd_sessions"]) == ("drift", 0)
    assert abs(joint["error_deg"] - drift * (sessions - 1)) < 3 * joint["error_u_deg"] < 0.03
    assert joint["excess"] < 2


def test_scatter_far_beyond_what_is_stated_is_not_said_to_be_steady() -> None:
    scatter = np.random.default_rng(23).normal(0, 0.04, 14)
    results = assessed(monthly(scatter, seed=21))
    assert not len(results.table("changes"))
    assert results.table("joints").set_index("joint").loc[5, "state"] == "scattered"
    # what chance gives, and what is but twice as much, is
    for times in (0.0, 0.2):
        states = assessed(monthly(times * scatter, seed=21)).table("joints")["state"]
        assert set(states) == {"steady"}


@pytest.mark.parametrize("count", [6, 14])
def test_constant_series_seldom_show_a_change(count: int) -> None:
    rng, named = np.random.default_rng(count), 0
    for _ in range(100):
        u = rng.uniform(0.004, 0.008, count)
        t = np.arange(count) * 30.0
        zeros = np.zeros(count)
        series = JointSeries(
            "a", 1, ("",) * count, t, rng.normal(0, u), u, zeros, zeros.astype(int)
        )
        named += assess_joint(series, 0.05).state != "steady"
    assert named <= stats.binom.isf(0.001, 100, 0.05)


def scattered_series(rng: np.random.Generator, count: int, step: float = 0.0) -> JointSeries:
    """Sessions that scatter 2.5 times what they state; a step (u) in the middle."""
    u, zeros = rng.uniform(0.015, 0.04, count), np.zeros(count)
    t = np.sort(rng.uniform(0, 365, count))
    error = rng.normal(0, 2.5 * u) + step * np.median(u) * (np.arange(count) >= count // 2)
    return _with_excess(JointSeries("a", 1, ("",) * count, t, error, u, zeros, zeros.astype(int)))


@pytest.mark.parametrize("count", [6, 8, 12])
def test_scatter_beyond_what_is_stated_seldom_shows_a_change(count: int) -> None:
    rng = np.random.default_rng(1)
    false_alarm = P_FALSE_ALARM / 18  # a fleet of three arms
    found = [assess_joint(scattered_series(rng, count), false_alarm) for _ in range(720)]
    changed = [len(one.course.changes) for one in found]
    for named in (changed, [one.course.odd.sum() for one in found]):
        assert np.count_nonzero(named) <= stats.binom.isf(0.001, 720, false_alarm)
    # what the stated uncertainties do not explain is not said to be steady either
    assert any(one.state == "unclear" for one in found)


def test_a_step_far_beyond_the_scatter_is_found_by_few_sessions() -> None:
    rng = np.random.default_rng(2)
    for count, step in ((8, 50.0), (12, 25.0)):
        found = [assess_joint(scattered_series(rng, count, step), 0.01 / 18) for _ in range(20)]
        assert {one.state for one in found} <= {"step", "change"}
        assert {one.course.changes[0].term.place for one in found} == {count // 2}


def test_one_odd_session_is_marked_and_is_no_change() -> None:
    sessions = rows(6)
    at = sessions.index[sessions["robot"] == "arm_a"][37]
    sessions.loc[at, "q2_mean_error_deg"] += 1.0
    results = assessed(sessions)
    assert not len(results.table("changes"))
    points = results.table("points")
    odd = points[points["odd"]]
    assert [(r.arm, r.joint, r.session) for r in odd.itertuples()] == [
        ("arm_a", 2, sessions.loc[at, "session"])
    ]


def test_a_new_calibration_within_what_it_states_is_no_change() -> None:
    sessions = rows(7, calibrations=2, shared=0.1)
    assert not len(changes(sessions))
    stated = [c for c in sessions if c.endswith("_standard_uncertainty_deg") and "worst" not in c]
    exact = sessions.copy()
    for column in stated:  # the same figures, the calibrations taken as exact
        exact[column] = exact[column.replace("standard", "session")]
    found = changes(exact)
    assert len(found)
    assert found["recalibrated"].all()


def test_least_squares_agree_with_the_whole_covariance_matrix() -> None:
    series = series_of(rows(8, sessions=30, calibrations=3).query("robot == 'arm_a'"), "a", 1)
    design = np.column_stack([np.ones(30), np.random.default_rng(8).normal(size=30)])
    inverse = np.linalg.inv(dense(series))
    solved = apply_inverse_covariance(series, design)
    np.testing.assert_allclose(solved, inverse @ design, rtol=1e-9)
    found = fit(series, design)
    covariance = np.linalg.inv(design.T @ inverse @ design)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-9)

    def chi2(columns: np.ndarray) -> float:
        solved = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse @ series.error)
        left = series.error - columns @ solved
        return float(left @ inverse @ left)

    assert found.chi2 == pytest.approx(chi2(design), rel=1e-9)
    months = series.t - series.t[0]
    tried = scan(series, months, design, found)
    for k in range(1, 29):
        later = (np.arange(30) >= k).astype(float)
        drift = np.maximum(months - months[k], 0.0)
        for column, gain in ((later, tried["step"][k]), (drift, tried["drift"][k])):
            whole = chi2(design) - chi2(np.column_stack([design, column]))
            assert gain == pytest.approx(whole, rel=1e-6, abs=1e-9)


def test_a_series_too_short_for_a_change_has_none() -> None:
    series = series_of(rows(9, sessions=3).query("robot == 'arm_a'"), "a", 1)
    assert candidates(series) == []
    assert find_changes(series, 0.01).changes == ()


def test_sessions_of_one_time_show_no_drift() -> None:
    sessions = monthly(np.array([0.0, 9.0, 0.1, 5.0, 5.0, 0.1, 0.3, -7.0, 3.0]), seed=4)
    sessions["started"] = pd.Timestamp(BEGIN)
    assert not candidates(series_of(sessions, "a", 5))  # nor a step: nothing puts them in order
    assert assessed(sessions).table("joints")["state"].tolist()[4] == "scattered"


def test_a_step_lies_between_two_starts() -> None:
    sessions = monthly(np.repeat([0.0, 1.0, 0.0, 1.0], 4), seed=4)
    starts = pd.Series(np.repeat([0, 30], 8))  # days; of either day half the sessions are off
    sessions["started"] = pd.Timestamp(BEGIN) + pd.to_timedelta(starts, "D")
    places = [one.place for one in candidates(series_of(sessions, "a", 5)) if one.kind == "step"]
    assert places == [8]
    assert not len(changes(sessions))


def test_changes_after_several_sessions_of_one_start_are_found() -> None:
    month = np.array([0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8])
    error, zeros = np.repeat([0.0, 8.0, 4.0], 4), np.zeros(12)
    series = JointSeries(
        "a", 1, ("",) * 12, DAYS_PER_MONTH * month, error, zeros + 0.25, zeros, zeros.astype(int)
    )
    found = find_changes(series, 0.01).changes
    assert [(c.term.kind, c.term.place) for c in found] == [("step", 4), ("step", 8)]


def test_before_and_after_a_day_compares_each_joint() -> None:
    table = assessed(rows(10, step=0.3), since=date(2025, 6, 10)).table("contrasts")
    assert len(table) == 18
    shown = table[table["shown"]]
    assert [(r.arm, r.joint) for r in shown.itertuples()] == [("arm_b", 5)]
    one = shown.iloc[0]
    assert abs(one["difference_deg"] - 0.3) < 3 * one["difference_u_deg"]
    assert one["first_sessions"] + one["second_sessions"] == 100
    series = series_of(rows(12, sessions=20, shared=0.0).query("robot == 'arm_a'"), "a", 1)
    second = np.arange(20) >= 8
    first, other = (
        np.average(series.error[side], weights=series.scatter[side] ** -2.0)
        for side in (~second, second)
    )
    assert contrast(series, second, 0.05).difference == pytest.approx(other - first)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 8])
def test_scatter_beyond_what_is_stated_seldom_shows_a_difference(count: int) -> None:
    rng, second = np.random.default_rng(1), np.arange(count) >= count // 2
    found = [contrast(scattered_series(rng, count), second, 0.001) for _ in range(2000)]
    shown = sum(abs(one.difference) > one.limit for one in found)
    assert shown <= stats.binom.isf(0.001, 2000, 0.001)
    # where it is beyond what is stated, that is said
    assert any(abs(one.difference) > one.expected for one in found)
    if count > 4:  # more than one session a side and one to spare show what is plain
        plain = contrast(scattered_series(rng, count, 1000.0), second, 0.001)
        assert plain.difference > plain.limit


def test_a_difference_of_two_sessions_is_neither_a_change_nor_none() -> None:
    sessions = rows(12, sessions=2, shared=0.0)
    moved = sessions["session"].str.endswith("001")
    sessions.loc[moved, "q1_mean_error_deg"] += 1.0
    day = sessions["started"].groupby(sessions["robot"]).max().min().date()
    table = assessed(sessions, since=day).table("contrasts")
    assert not table["shown"].any()
    assert table[table["joint"] == 1]["unclear"].any()


def test_two_folders_are_compared_and_one_without_sessions_is_refused() -> None:
    sessions = rows(11)
    moved = sessions["robot"] == "arm_b"
    sessions.loc[moved, "robot"] = "arm_a"  # the same arm, its sessions in two folders
    sessions.loc[moved, "q1_mean_error_deg"] += 0.5
    folders = ("lab/arm_a", "lab/arm_b/")
    table = assessed(sessions, compare=folders).table("contrasts")
    assert 1 in set(table[table["shown"]]["joint"])
    names = sessions["session"].tolist()
    require_folders(names, TrendRequest(compare=folders))
    for both in (("lab/arm_a", "lab/arm_a/"), ("lab", "lab/arm_b")):
        with pytest.raises(InputError, match="both hold the session lab/arm_"):
            require_folders(names, TrendRequest(compare=both))
    with pytest.raises(InputError, match="lab/arm_z"):
        require_folders(names, TrendRequest(compare=("lab/arm_a", "lab/arm_z")))


def test_arms_of_one_kind_are_distinguished_by_folder() -> None:
    sessions = rows(13, sessions=20)
    sessions["robot"] = "same"
    assert assessed(sessions).summary["arms"] == ["same"]
    by = assessed(sessions, by="folder").summary["arms"]
    assert by == ["same in arm_a", "same in arm_b", "same in arm_c"]


def two_arms_as_one(offset: float, *, alternating: bool = True) -> pd.DataFrame:
    """Sessions of two arms of one robot file; joint 2 of the second is off."""
    sessions = rows(15, sessions=12).query("robot != 'arm_c'").copy()
    second = sessions["robot"] == "arm_b"
    sessions["calibration"] = sessions["robot"]
    sessions["robot"] = "same"
    sessions.loc[second, "q2_mean_error_deg"] += offset
    if not alternating:
        sessions.loc[second, "started"] += pd.Timedelta(days=400)
    return sessions


def test_sessions_that_differ_by_folder_and_not_by_time_may_be_of_several_arms() -> None:
    (text,) = several_arms(assessed(two_arms_as_one(0.8)))
    assert re.match(
        r"same: the 12 sessions in lab/arm_. differ in joint 2 by [+−]0\.[78]\d+° ± .* --by folder",
        text,
    )
    gathered = two_arms_as_one(0.8)
    gathered["session"] = gathered["session"].str.replace("arm_b/", "arm_a/b")
    (text,) = several_arms(assessed(gathered))
    assert "of one calibration differ in joint 2" in text
    for other in (two_arms_as_one(0.0), two_arms_as_one(0.8, alternating=False)):
        assert not several_arms(assessed(other))
    assert not several_arms(assessed(two_arms_as_one(0.8), by="folder"))


def test_folders_of_one_arm_are_seldom_said_to_be_several_arms() -> None:
    told = 0
    for seed in range(40):
        sessions = rows(3000 + seed, sessions=8, scatter=2.5)
        folder = np.random.default_rng(seed).choice(["monday", "friday"], len(sessions))
        sessions["session"] = sessions["session"].str.replace("lab/", "") + "/"
        sessions["session"] = folder + "/" + sessions["session"].str.replace("/", "-")
        told += bool(several_arms(assessed(sessions)))
    assert told <= stats.binom.isf(0.001, 40, P_FALSE_ALARM)


def test_serial_numbers_distinguish_arms() -> None:
    sessions = two_arms_as_one(0.0)
    assert assessed(sessions.assign(serial_number="7")).summary["arms"] == ["same"]
    sessions["serial_number"] = sessions["calibration"].map({"arm_a": "A7", "arm_b": None})
    assert assessed(sessions).summary["arms"] == ["same"]
    sessions["serial_number"] = sessions["calibration"].map({"arm_a": "A7", "arm_b": "B8"})
    assert assessed(sessions).summary["arms"] == ["same no. A7", "same no. B8"]


def test_an_undecided_session_is_listed_with_what_is_undecided() -> None:
    sessions = rows(16, sessions=1)
    sessions[["verdict", "position_verdict"]] = "undecided"
    sessions[[f"q{j}_verdict" for j in range(1, 7)]] = "conform"
    assert assessed(sessions).table("worst")["pose"].tolist() == ["position"] * 3
    small = sessions["q1_worst_error_deg"].abs().idxmin()
    sessions.loc[small, ["q1_verdict", "q1_worst_error_deg"]] = ["undecided", 1e-6]
    worst = assessed(sessions).table("worst").set_index("session")
    assert worst.loc[sessions["session"][small], "joint"] == 1


def test_sessions_without_date_or_figure_are_counted() -> None:
    sessions = rows(14, sessions=10)
    sessions.loc[3, "started"] = pd.NaT
    sessions.loc[5, "q4_mean_error_deg"] = np.nan
    sessions["q6_mean_error_deg"] = np.nan  # never shown
    results = assessed(sessions)
    joints = results.table("joints").set_index(["arm", "joint"])
    assert joints.loc[("arm_a", 4), "sessions"] == 8
    assert joints.loc[("arm_a", 6), "state"] == "unknown"
    assert results.summary["sessions"]["undated"] == 1
    assert not len(results.table("changes"))
