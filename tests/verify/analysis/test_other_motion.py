"""Readings of another motion are refused, with the mistake that explains them; faults are not."""

import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag

import robots
from robots.transforms import rotation_exp
from tests.support.motions import ARM, HOME, SWING, make_track
from tests.support.published import write_session
from tests.support.true_arm import measured, readings, true_arm
from verify.analysis.clock.estimate import estimate_clock
from verify.analysis.instrument import MeasuredSession, measure_poses, stated_noise
from verify.analysis.measured import measure_pictures, session_clock, with_shown_noise
from verify.analysis.mistakes import degrees
from verify.analysis.other_motion import refuse_other_motion
from verify.analysis.plausibility import clock_changes, clock_rate, late_joints
from verify.analysis.session import compare_session, session_model
from verify.calibration.kinematics.poses import build_poses
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.keys import Clock
from verify.io.session.session import Session, open_session
from verify.measurement.chain import measure
from verify.measurement.track import Track, subset

SAMPLE = Path(__file__).parents[3] / "sample_sessions" / "multi_joint_fault_6r"


@pytest.fixture(scope="module")
def seen() -> tuple[Session, MeasuredSession]:
    session = replace(open_session(SAMPLE), clock=None)
    return session, measure_pictures(session, lambda _done, _total: None, measure)


@pytest.fixture(scope="module")
def recording(seen: tuple[Session, MeasuredSession]) -> tuple[Session, Track]:
    return seen[0], seen[1].track


def judge(recording: tuple[Session, Track], q: Array) -> None:
    session, track = recording
    readings = Readings(session.encoders.t, q)
    refuse_other_motion(session, track, readings, estimate_clock(track, session.arm, readings))


def reverse_first(q: Array) -> Array:
    return q * [-1, 1, 1, 1, 1, 1]


def reverse_three(q: Array) -> Array:
    return q * [1, -1, -1, 1, -1, 1]


def mirror_fourth_halfway(q: Array) -> Array:
    return np.where((np.arange(6) == 3) & (np.arange(len(q)) >= 168)[:, None], -q, q)


def reverse_third_late(q: Array) -> Array:
    """The elbow is in the other branch, there, where steps of three joints explain as much."""
    late = np.arange(len(q)) >= int(0.8 * len(q))
    return np.where((np.arange(6) == 2) & late[:, None], -q, q)


def freeze(q: Array) -> Array:
    return np.tile(q[0], (len(q), 1))


def stop_third(q: Array) -> Array:
    return np.where(np.arange(6) == 2, q[0], q)


def stop_fifth_halfway(q: Array) -> Array:
    half = len(q) // 2
    return np.where((np.arange(6) == 4) & (np.arange(len(q)) >= half)[:, None], q[half], q)


def stall(q: Array) -> Array:
    """All joints hold for 0.4 s: the log goes on, and the arm."""
    held = q.copy()
    held[125:145] = q[125]
    return held


def delay_second_and_fourth(q: Array) -> Array:
    """Readings of 50 Hz, those of joint 4 one row and a half late, those of joint 2 three rows."""
    late, later = q.copy(), q.copy()
    late[2:] = (q[1:-1] + q[:-2]) / 2
    later[3:] = q[:-3]
    return np.select([np.arange(6) == 3, np.arange(6) == 1], [late, later], q)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (
            delay_second_and_fourth,
            r"joint 2 \(0\.060 s late\) and joint 4 \(0\.030 s late\) .*, q4_deg by -0\.030 s",
        ),
        (stop_fifth_halfway, r"joint 5 stand still from t_s = 2\.\d* to 5\.\d* while it turns by"),
        (stall, r"joints 1, .* stand still from t_s = 2\.82 to 3\.20 while they turn by"),
        (
            reverse_three,
            r"joints 2, 3, 5 reversed fits.* columns q2_deg, q3_deg, q5_deg by -1",
        ),
        (reverse_first, r"encoders\.csv: .*joint 1 reversed fits.* column q1_deg by -1"),
        (
            mirror_fourth_halfway,
            r"joint 4 with its sign changed at t_s = 3\.\d+ fits.* q4_deg by -1 from there on",
        ),
        (
            reverse_third_late,
            r"joint 3 with its sign changed at t_s = 4\.\d+ fits.* q3_deg by -1 from there on",
        ),
        (
            lambda q: np.where(np.isin(np.arange(6), [1, 4, 5]), np.deg2rad(q), q),
            r"joints 2, 5, 6 taken as radians fits.* q2_deg, q5_deg, q6_deg by 180/π",
        ),
        (stop_third, r"joint 3 never change while it turns.* column q3_deg"),
        pytest.param(freeze, "readings never change", marks=pytest.mark.slow),
    ],
)
def test_a_mistake_is_named(
    recording: tuple[Session, Track], mistake: Callable[[Array], Array], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        judge(recording, mistake(recording[0].encoders.q))


def test_pairs_in_a_gap_of_the_log_are_left_out_and_said(
    seen: tuple[Session, MeasuredSession],
) -> None:
    """A curve over half a second of motion is off by a tenth of a degree, more than its noise."""
    session, track = seen[0], seen[1].track
    kept = np.abs(session.encoders.t - 3.0) > 0.25
    log = Readings.of_log(session.encoders.t[kept], session.encoders.q[kept])
    clock = estimate_clock(track, session.arm, log)
    compared, _ = compare_session(session, seen[1], log, clock)
    lost = np.setdiff1d(np.arange(len(track)), compared.comparison.index)
    assert np.abs(track.t[lost] - clock.offset - 3.0).max() < 0.28
    assert re.search(
        r"[78] of 60 pairs have no reading .* 0\.52 s .* 2\.74", compared.session.warnings[-1]
    )
    fault = np.deg2rad([0, 0.35, 0, 0, 0, 0])
    assert np.rad2deg(np.nanmax(np.abs(compared.joints.single - fault))) < 0.1


@pytest.mark.parametrize("wrong", [0.09, -0.09])
def test_a_given_clock_that_is_wrong_is_named_and_no_link_or_base(
    seen: tuple[Session, MeasuredSession], wrong: float
) -> None:
    """Joints are off by degrees, and no longer in proportion to their speeds."""
    session = replace(seen[0], clock=Clock(0.085 + wrong, 5e-4))
    log = Readings(session.encoders.t, session.encoders.q)
    clock = session_clock(session, seen[1].track, log)
    refuse_other_motion(session, seen[1].track, log, clock)
    compared = compare_session(session, seen[1], log, clock)[0]
    model, found, resolved = session_model(compared)
    assert {(cause.kind, cause.joint) for cause in found.causes} == {("offset", 2), ("clock", None)}
    named = next(cause.value for cause in found.causes if cause.kind == "clock")
    assert named == pytest.approx(-wrong, abs=2e-3)
    assert np.rad2deg(resolved.mean) == pytest.approx([0, 0.35, 0, 0, 0, 0], abs=0.01)
    assert np.array_equal(model.comparison.xi, compared.comparison.xi)  # the whole error is told


@pytest.mark.parametrize("given", [1.0, -1.5, 7.5])
@pytest.mark.parametrize("slip_deg", [0, 8])
def test_a_given_clock_that_is_far_off_is_refused_with_the_one_that_fits(
    seen: tuple[Session, MeasuredSession], given: float, slip_deg: float
) -> None:
    """Without any clock the same session is measured."""
    session, track = replace(seen[0], clock=Clock(given)), seen[1].track
    log = Readings(session.encoders.t, session.encoders.q + np.deg2rad([0, slip_deg, 0, 0, 0, 0]))
    fits = rf"encoder_offset_s = {given:g} puts joints off by .*; 0\.08[56] s fits"
    with pytest.raises(InputError, match=fits) as refused:
        refuse_other_motion(session, track, log, session_clock(session, track, log))
    assert "Write encoder_offset_s = 0.08" in str(refused.value)
    free = replace(session, clock=None)
    refuse_other_motion(free, track, log, session_clock(free, track, log))


@pytest.mark.parametrize("joint", [2, 4])
def test_a_second_of_noisy_readings_is_named_and_accuses_nobody(
    seen: tuple[Session, MeasuredSession], joint: int
) -> None:
    session, q = seen[0], seen[0].encoders.q.copy()
    rough = np.abs(session.encoders.t - 3.0) < 0.5
    q[rough, joint] += np.random.default_rng(3).normal(0, np.deg2rad(1.0), np.count_nonzero(rough))
    log = Readings.of_log(session.encoders.t, q)
    said = with_shown_noise(session, log).warnings[-1]
    assert re.search(
        rf"of joint {joint + 1} scatter by [01]\.?\d*° between t_s = 2\..* and 3\.", said
    )
    clock = estimate_clock(seen[1].track, session.arm, log)
    _, found, resolved = session_model(compare_session(session, seen[1], log, clock)[0])
    assert [(cause.kind, cause.joint) for cause in found.causes] == [("offset", 2)]
    assert np.rad2deg(resolved.mean) == pytest.approx([0, 0.35, 0, 0, 0, 0], abs=0.01)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("change", [0.2, -0.1, 0.008])
def test_a_clock_that_is_set_in_the_session_is_named(
    recording: tuple[Session, Track], change: float, known: bool
) -> None:
    """Stamps go on later from a row on, or, where rows are missing, earlier."""
    session, track = recording
    t, q = session.encoders.t, session.encoders.q
    late = t >= 3.0
    kept = ~late | (t + change > 3.0)
    log = Readings.of_log((t + change * late)[kept], q[kept])
    clock = session_clock(replace(session, clock=Clock(0.085, 1e-4) if known else None), track, log)
    said = (
        rf"clock was set by \{change:+.3f} s between t_s = (.*) and (.*); .* \{-change:+.3f} s to"
    )
    with pytest.raises(InputError, match=said) as refusal:
        refuse_other_motion(session, track, log, clock)
    since, until = map(float, re.findall(r"\d\.\d\d(?= and|;)", str(refusal.value)))
    assert 2.85 < since <= 3.0 <= until < 3.3


def test_a_joint_that_holds_twice_for_a_few_pairs_of_many_is_named(
    recording: tuple[Session, Track],
) -> None:
    session, track = recording
    t = np.linspace(track.t[0], track.t[-1], 2 * len(track))
    told = Readings(session.encoders.t, session.encoders.q)
    flange = robots.forward(session.arm, told.at(t - 0.085))
    many = replace(subset(track, np.arange(len(t)) // 2), t=t, base_T_flange=flange)
    speed = np.abs(np.gradient(told.q[:, 5]))
    q = session.encoders.q.copy()
    for half in (slice(40, 120), slice(140, 220)):
        start = half.start + int(np.argmax(speed[half])) - 5
        q[start : start + 12, 5] = q[start, 5]
    with pytest.raises(InputError, match=r"those of joint 6 stand still from .* while it turns by"):
        judge((session, many), q)


def test_a_resting_joint_whose_noise_repeats_a_reading_does_not_stand_still(
    recording: tuple[Session, Track],
) -> None:
    """Poses that determine it to degrees are no sign that it turned."""
    session, track = recording
    rest = np.where(np.arange(6) == 3, np.deg2rad(8.0), session.encoders.q)
    noise = np.random.default_rng(4).normal(0.0, np.deg2rad(0.01), rest.shape)
    angles = Readings(session.encoders.t, rest).at(track.t - 0.085)
    angles[:, 3] += np.deg2rad(2.4) * np.exp(-np.square((track.t - 3.0) / 0.3))
    poses = replace(track, base_T_flange=robots.forward(session.arm, angles))
    judge((session, poses), rest + noise)


@pytest.mark.parametrize(("ahead", "what"), [(1, "lost 1"), (-2, "repeated 2")])
def test_pictures_that_both_cameras_lose_or_repeat_are_told_beside_the_clock(
    recording: tuple[Session, Track], ahead: int, what: str
) -> None:
    """From a row on, both pictures are those of a later or an earlier instant."""
    session, track = recording
    rows = np.arange(2, len(track) - 2)
    shown = rows + ahead * (rows >= len(track) // 2)
    shifted = replace(subset(track, rows), base_T_flange=track.base_T_flange[shown])
    with pytest.raises(InputError, match=rf"clock was set .* both cameras {what} .* frames\.csv"):
        judge((session, shifted), session.encoders.q)


@pytest.mark.parametrize(
    "stretch", [(0.3, 0.7), (0.5, 0.75), (0.4, 0.7), (0.5, 0.58), (0.2, 0.27), (0.9, 0.98)]
)
def test_pictures_that_are_late_in_a_stretch_are_two_changes_of_the_clock(
    recording: tuple[Session, Track], stretch: tuple[float, float]
) -> None:
    session, track = recording
    since, until = (int(share * len(track)) for share in stretch)
    rows = np.arange(len(track))
    shown = rows - 2 * ((rows >= since) & (rows < until))
    shifted = replace(track, base_T_flange=track.base_T_flange[shown])
    step = 2 * float(np.median(np.diff(track.t)))
    with pytest.raises(InputError, match=r"clock was set by .*, and by ") as refused:
        judge((session, shifted), session.encoders.q)
    said = [float(size) for size in re.findall(r"by ([-+][\d.]+) s between", str(refused.value))]
    assert said == pytest.approx([-step, step], abs=0.005)


def test_a_clock_that_runs_fast_or_a_belt_that_slips_is_no_change_of_the_clock(
    recording: tuple[Session, Track],
) -> None:
    session, track = recording
    t, q = session.encoders.t, session.encoders.q
    slipped = q + np.deg2rad(3.0) * np.outer(t > 3.0, np.eye(6)[4])
    twice = q + np.deg2rad(3.0) * np.outer((t > 2.5) & (t < 4.0), np.eye(6)[4])
    for log in (*(Readings(t, one) for one in (slipped, twice, q * 1.05)), Readings(t * 1.004, q)):
        offset = estimate_clock(track, session.arm, log).offset
        assert clock_changes(track, session.arm, log, offset) == []


def test_a_slip_of_a_joint_that_turns_alone_is_no_change_of_the_clock() -> None:
    """By what it turns from pair to pair, for a second: late pictures would look the same."""
    log, t = np.arange(-1.0, 17.0, 0.01), np.arange(0.0, 16.0, 1 / 15)

    def sweep(t: Array) -> Array:
        """60° forth and back in 8 s, 15° a second."""
        return HOME + np.outer(np.deg2rad(60.0) * np.abs((t / 8) % 1 - 0.5), np.eye(6)[0]) * 2

    track = make_track(t, sweep(t), np.random.default_rng(1))
    slip = 1 / 15 * np.deg2rad(15.0) * np.outer((log > 5.03) & (log < 6.03), np.eye(6)[0])
    assert clock_changes(track, ARM, Readings(log, sweep(log) + slip), 0.0) == []


@pytest.mark.parametrize("fast", [-0.1, -0.05, -0.02, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("late", ["readings", "pictures"])
def test_times_written_by_a_nominal_rate_are_refused(
    recording: tuple[Session, Track], fast: float, late: str
) -> None:
    """Beside a joint that is off, and one with backlash."""
    session, track = recording
    t, q = session.encoders.t, session.encoders.q.copy()
    q[:, 3] += np.deg2rad(0.5) * Readings(t, q).direction(t)[:, 3]
    if late == "pictures":
        track = replace(track, t=track.t / (1 + fast))
    log = Readings(t * (1 + fast) if late == "readings" else t, q)
    with pytest.raises(InputError, match=r"t_s runs .* against frames\.csv") as refused:
        refuse_other_motion(session, track, log, session_clock(session, track, log))
    found = re.search(r"([\d.]+) % (fast|slow).*Multiply t_s by ([\d.]+),", str(refused.value))
    assert found is not None
    assert float(found[1]) == pytest.approx(100 * abs(fast), abs=0.05)
    assert found[2] == ("fast" if fast > 0 else "slow")
    assert float(found[3]) == pytest.approx(1 / (1 + fast), abs=5e-4)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("seconds", [5.0, pytest.param(40.0, marks=pytest.mark.slow)])
def test_a_rate_is_found_in_any_motion_and_none_in_faults(seed: int, seconds: float) -> None:
    rng = np.random.default_rng(seed)
    period, phase = rng.uniform(2.0, 5.0, 6), rng.uniform(0, 6, 6)

    def motion(t: Array) -> Array:
        return HOME + SWING * np.sin(2 * np.pi * t[:, None] / period + phase)

    log, swing = np.arange(-1.0, seconds + 1.0, 0.02), np.eye(6)[seed]
    track = make_track(np.arange(0.0, seconds, 0.1), motion(np.arange(0.0, seconds, 0.1)), rng)
    q = motion(log)
    for fast in (-0.07, 0.03):
        offset = -fast * seconds / 2
        found = clock_rate(track, ARM, Readings(log * (1 + fast), q), offset)
        assert found == pytest.approx(fast, rel=0.01)
    assert clock_rate(track, ARM, Readings(log * 1.0004, q), 0.0) is None
    for faulty in (
        q + np.deg2rad(20.0) * swing,
        q * (1 + 0.1 * swing),
        q + np.deg2rad(2.0) * np.outer(np.cos(3 * q[:, seed]), swing),
        np.where(swing > 0, np.roll(q, 5, axis=0), q),
        np.where(log[:, None] > seconds / 2, q + np.deg2rad(4.0) * swing, q),
        np.where(log[:, None] > seconds / 2, np.roll(q, 8, axis=0), q),
        motion(log * 0.5 + 2.0)[:, ::-1],
    ):
        assert clock_rate(track, ARM, Readings(log, faulty), 0.0) is None


@pytest.mark.parametrize("joint", [0, 3])
def test_backlash_and_another_clock_are_no_late_joint(
    recording: tuple[Session, Track], joint: int
) -> None:
    session, track = recording
    log = Readings(session.encoders.t, session.encoders.q)
    offset = estimate_clock(track, session.arm, log).offset
    q = log.q.copy()
    q[:, joint] += np.deg2rad(1.0) * log.direction(log.t)[:, joint]
    assert not late_joints(track, session.arm, Readings(log.t, q), offset)
    assert not late_joints(track, session.arm, log, offset + 0.1)


def test_a_joint_at_rest_is_not_taken_for_a_standing_encoder() -> None:
    """Joints 2 to 6 hold; where the base is off they seem to turn as joint 1 does."""
    session = open_session(SAMPLE.with_name("quarter_circle_6r"))
    track = measure_pictures(session, lambda _done, _total: None, measure).track
    base = block_diag(rotation_exp(np.radians([1.0, 0.0, 0.0])), 1)
    moved = replace(track, base_T_flange=base @ track.base_T_flange)
    log = Readings(session.encoders.t, np.round(session.encoders.q, 2))
    log.q[:100, 1:] += np.linspace(-0.1, 0, 100)[:, None]  # they came there before
    refuse_other_motion(session, moved, log, session_clock(session, moved, log))


def test_a_base_written_the_wrong_way_round_is_named(recording: tuple[Session, Track]) -> None:
    session, track = recording
    base_T_rig = np.asarray(np.linalg.inv(session.rig.rig_T_base), dtype=np.float64)
    wrong = replace(session, rig=replace(session.rig, rig_T_base=base_T_rig))
    moved = replace(
        track, base_T_flange=session.rig.rig_T_base @ session.rig.rig_T_base @ track.base_T_flange
    )
    with pytest.raises(InputError, match=r"rig\.toml: .*base inverted fits"):
        judge((wrong, moved), session.encoders.q)


def test_the_rig_that_was_given_is_blamed_and_not_the_session_s_own(
    recording: tuple[Session, Track], tmp_path: Path
) -> None:
    session, track = recording
    turned = block_diag(rotation_exp(np.radians([0, 83.0, 0])), 1)
    wrong = replace(session, rig_file=tmp_path / "other.toml")
    moved = replace(track, base_T_flange=turned @ track.base_T_flange)
    with pytest.raises(InputError, match=r"other\.toml: .*base turned by 83°"):
        judge((wrong, moved), session.encoders.q)


def test_leds_with_a_sign_reversed_are_named() -> None:
    session = open_session(SAMPLE)
    marker = replace(session.marker, leds=session.marker.leds * [-1.0, 1.0, 1.0])
    wrong = replace(session, marker=marker)
    track = measure_pictures(wrong, lambda _done, _total: None, measure).track
    with pytest.raises(InputError, match=r"marker\.toml: .*reversed x lie there.* or register"):
        judge((wrong, track), session.encoders.q)
    turned = block_diag(rotation_exp(np.radians([83.0, 0, 0])), 1)
    track = measure_pictures(session, lambda _done, _total: None, measure).track
    moved = replace(track, base_T_flange=track.base_T_flange @ turned)
    with pytest.raises(InputError, match=r"turned by 83°.*Nothing can be judged"):
        judge((session, moved), session.encoders.q)


def test_a_registration_that_shows_the_same_is_named_with_a_zero(
    recording: tuple[Session, Track],
) -> None:
    q = recording[0].encoders.q
    for joint, what in ((0, "robot's base"), (5, "LEDs on the flange")):
        moved = q + np.radians(90) * np.eye(6)[joint]
        said = rf"column q{joint + 1}_deg, or correct the place of the {what}, if that is turned"
        with pytest.raises(InputError, match=said):
            judge(recording, moved)
    assert degrees(np.radians(131.0)) == "130°"


@pytest.mark.parametrize(
    "size_deg", [4.0, pytest.param(40.0, marks=pytest.mark.slow)], ids=["small", "large"]
)
def test_an_offset_and_a_slipped_belt_are_faults(
    recording: tuple[Session, Track], size_deg: float
) -> None:
    session, _ = recording
    for since in (0.0, float(np.median(session.encoders.t))):
        q = session.encoders.q.copy()
        q[session.encoders.t >= since, 2] += np.deg2rad(size_deg)
        judge(recording, q)


@pytest.mark.parametrize("zeros_deg", [(0, 20, 0, 0, 0, 0), (25, 0, -15, 0, 0, 0)])
@pytest.mark.parametrize("given", [False, True])
def test_zeros_that_are_tens_of_degrees_off_are_named_and_accuse_nobody_else(
    seen: tuple[Session, MeasuredSession], zeros_deg: tuple[float, ...], given: bool
) -> None:
    """Far beyond what first order about the readings says."""
    session, fault = seen[0], np.array([0, 0.35, 0, 0, 0, 0])
    session = replace(session, clock=Clock(0.085, 1e-4) if given else None)
    log = Readings(session.encoders.t, session.encoders.q + np.deg2rad(zeros_deg))
    clock = session_clock(session, seen[1].track, log)
    assert clock.offset == pytest.approx(0.085, abs=2e-4)
    refuse_other_motion(session, seen[1].track, log, clock)
    compared, _ = compare_session(session, seen[1], log, clock)
    _, found, resolved = session_model(compared)
    truth = fault + zeros_deg
    assert [cause.kind for cause in found.causes] == ["offset"] * np.count_nonzero(truth)
    for cause in found.causes:
        off = cause.value - np.deg2rad(truth[(cause.joint or 0) - 1])
        assert abs(off) < 4 * cause.standard_uncertainty
    assert np.rad2deg(resolved.mean) == pytest.approx(truth, abs=0.01)
    assert np.rad2deg(np.diag(resolved.mean_covariance) ** 0.5).max() < 0.01


@pytest.mark.parametrize("size_deg", [5.0, pytest.param(15.0, marks=pytest.mark.slow)])
def test_a_belt_that_slips_hides_no_clock_and_accuses_nobody_else(
    seen: tuple[Session, MeasuredSession], size_deg: float
) -> None:
    session, track = seen[0], seen[1].track
    t, q = session.encoders.t, session.encoders.q.copy()
    plain = estimate_clock(track, session.arm, Readings(t, session.encoders.q))
    q[len(q) // 2 :, 4] += np.deg2rad(size_deg)
    clock = estimate_clock(track, session.arm, Readings(t, q))
    assert clock.source == "estimated"
    assert clock.offset == pytest.approx(plain.offset, abs=5e-4)
    compared, _ = compare_session(session, seen[1], Readings(t, q), clock)
    _, found, resolved = session_model(compared)
    named = {(cause.kind, cause.joint) for cause in found.causes if cause.kind != "ambiguous"}
    assert named == {("step", 5), ("offset", 2)}
    assert np.rad2deg(resolved.mean[[0, 2, 3, 4, 5]]) == pytest.approx(
        [0, 0, 0, size_deg / 2, 0], abs=0.02
    )


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("base", r"session\.toml: .*base turned by 20° and shifted by 0 mm fits: 0.\d* mm"),
        ("sign", r"encoders\.csv: .*joint 3 reversed fits: 0.\d* mm"),
        ("offset", ""),
        ("slip", ""),
    ],
)
def test_positions_alone_tell_mistakes_and_another_base_from_faults(
    spoil: str, message: str, tmp_path: Path
) -> None:
    truth = true_arm("iust_6r", 3, geometry=0.0, offsets=0.0)
    truth.world_T_base[:] = block_diag(
        rotation_exp(np.radians([0, 20.0 * (spoil == "base"), 0])), 1
    )
    q = readings(truth.arm, 40, 1)
    poses, _ = measured(replace(truth, flange_T_target=np.eye(4)), q, 1)
    if spoil == "sign":
        q[:, 2] *= -1
    q[20 * (spoil == "slip") :, 0] += np.deg2rad(40) * (spoil in ("offset", "slip"))
    rows = build_poses(q, poses)
    folder = write_session(tmp_path / "one", rows, robot="iust_6r", positions_alone=True)
    session = open_session(folder)
    log = Readings(session.encoders.t, session.encoders.q)
    assert session.instrument is not None
    track = measure_poses(session, session.instrument, log, stated_noise(session.instrument)).track
    clock = session_clock(session, track, log)
    with pytest.raises(InputError, match=message) if message else nullcontext():
        refuse_other_motion(session, track, log, clock)
