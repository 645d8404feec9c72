import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import BarycentricInterpolator, CubicHermiteSpline

from verify.core.readings import Readings


def wave(t, amplitude=0.3, period=2.0):
    return amplitude * np.sin(2 * np.pi * t / period)


def test_the_newest_interval_of_slow_readings_is_known_nearly_as_well_as_an_older_one() -> None:
    """Live there is no other: 20° at 0.6 Hz, read at 9 Hz, with and without a reading left out."""
    worst, ratios = 0.0, []
    for left_out in (False, True):
        for phase in np.linspace(0, 2 * np.pi, 50):
            t = np.arange(10) * 0.11
            t = np.delete(t, 8) if left_out else t
            q = np.deg2rad(20) * np.sin(2 * np.pi * 0.6 * t + phase)
            between = np.linspace(t[-2], t[-1], 12)[1:-1]
            truth = np.deg2rad(20) * np.sin(2 * np.pi * 0.6 * between + phase)
            readings = Readings(t, q[:, None])
            off = np.abs(readings.at(between)[:, 0] - truth)
            worst = worst if left_out else max(worst, float(off.max()))
            ratios.append(off / readings.interpolation_uncertainty(between)[:, 0])
    assert worst < np.deg2rad(0.05)  # a straight line's slope there: 0.3°
    assert 0.3 < np.sqrt(np.mean(np.square(np.clip(ratios, 0, 10)))) < 1.2


def test_what_readings_miss_is_nothing_at_them_and_for_a_parabola() -> None:
    t = np.array([0.0, 0.1, 0.22, 0.3, 0.43])
    readings = Readings(t, np.stack([3 * t**2 - t, np.sin(9 * t)], axis=1))
    assert_allclose(readings.interpolation_uncertainty(t), 0, atol=1e-15)
    assert_allclose(
        readings.interpolation_uncertainty(np.array([0.05, 0.15, 0.4]))[:, 0], 0, atol=1e-15
    )
    assert np.all(readings.interpolation_uncertainty(np.array([0.05, 0.15, 0.4]))[:, 1] > 1e-5)
    assert_allclose(Readings(t[:1], np.ones((1, 2))).interpolation_uncertainty(t), 0)


def test_two_or_three_readings_do_not_pass_for_a_curve_that_is_known() -> None:
    t = np.array([0.0, 0.2, 0.4])
    q = np.sin(4 * t)[:, None]
    for count in (2, 3):
        between = np.array([t[count - 1] - 0.1])
        few = Readings(t[:count], q[:count])
        off = abs(few.at(between)[0, 0] - np.sin(4 * between[0]))
        assert few.interpolation_uncertainty(between)[0, 0] > off / 3 > 1e-3


def test_the_speed_is_the_slope_of_the_motion() -> None:
    t = np.arange(0, 6, 0.02)
    readings = Readings(t, wave(t)[:, None])
    between = np.linspace(1, 5, 50)
    speed = readings.motion(between)[1][:, 0]
    assert_allclose(speed, 0.3 * np.pi * np.cos(np.pi * between), atol=0.005)


def test_noise_is_read_off_the_readings_and_motion_is_not_taken_for_noise() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0, 20, 0.02)
    sigma = np.deg2rad([0.01, 0.03])
    q = np.stack([wave(t), wave(t, 0.5, 3.0)], axis=1) + rng.normal(0, sigma, (len(t), 2))
    assert_allclose(Readings(t, q).noise, sigma, rtol=0.1)
    smooth = Readings(t, np.stack([wave(t), wave(t, 0.5, 3.0)], axis=1))
    assert np.all(smooth.noise < np.deg2rad(0.0005))
    burst = np.arange(len(t)) // 6  # a third of the second differences cross a gap
    apart = Readings(t + burst, q - smooth.q + 0.1 * (burst % 2)[:, None])
    assert_allclose(apart.noise, sigma, rtol=0.1)


def test_a_joint_s_rough_stretch_is_found_and_no_slow_motion_or_visits_pass_for_one() -> None:
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 8.0, 0.02)
    q = np.stack([wave(t), wave(t, 0.5, 3.0)], axis=1) + rng.normal(0, 2e-4, (len(t), 2))
    rough = (t > 3) & (t < 4)
    q[rough, 1] += rng.normal(0, 0.01, np.count_nonzero(rough))
    log = Readings(t, q)
    assert_allclose(log.noise_at(t[rough])[:, 1], 0.01, rtol=0.3)
    assert_allclose(log.noise_at(t), np.where(log.roughness > 0, log.roughness, log.noise))
    assert not log.roughness[:, 0].any()
    assert not log.roughness[(t < 2.6) | (t > 4.4)].any()
    slowly = np.where(t[::5] < 5, t[::5], 5.0)  # read at 10 Hz; then it rests
    assert not Readings(t[::5], np.stack([wave(slowly), wave(slowly, 0.5, 1.5)], 1)).roughness.any()
    assert not Readings(60.0 * t, rng.normal(0, 0.3, q.shape)).roughness.any()


@pytest.mark.parametrize("scatter", [0.0, 0.001, 0.004])
def test_the_scatter_of_time_stamps_is_read_off_all_joints_together(scatter: float) -> None:
    t, found = np.arange(0.0, 10.0, 0.02), []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        q = np.stack([0.3 * np.sin(w * t + w) for w in rng.uniform(0.5, 3.0, 6)], axis=1)
        q += rng.normal(0, np.deg2rad(0.01), q.shape)
        stamps = np.sort(t + rng.normal(0, scatter, len(t)))
        found.append(Readings(stamps, q).time_noise)
    assert_allclose(np.mean(found), scatter, rtol=0.15)


def test_noise_of_single_joints_is_no_scatter_of_time_stamps() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 10.0, 0.02)
    q = np.stack([0.3 * np.sin(w * t) for w in (0.5, 1.1, 1.7, 2.3)], axis=1)
    q += rng.normal(0, [1e-4, 1e-4, 1e-2, 1e-3], q.shape)
    assert Readings(t, q).time_noise == 0.0


def test_the_step_of_coarse_readings_is_found_and_noise_that_hides_it_counts_instead() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 10.0, 0.02)
    q = np.stack([0.3 * np.sin(w * t) for w in (0.5, 1.7)], axis=1)
    step = np.deg2rad(0.1)
    coarse = np.round(q / step) * step
    assert_allclose(Readings(t, coarse).step, step, rtol=1e-6)
    assert Readings(t, q).step == 0.0
    assert Readings(t, np.round((q + rng.normal(0, step, q.shape)) / step) * step).step == 0.0
    assert Readings(t, np.deg2rad([0.0, 5.0, 7.5])[(t * 0.3).astype(int)][:, None]).step == 0.0


def test_between_two_bursts_of_readings_nothing_is_known() -> None:
    t = np.concatenate([np.arange(0, 1, 0.1), np.arange(10, 11, 0.1)])
    readings = Readings(t, np.where(t < 5, 0.1, 0.7)[:, None])
    assert readings.available(np.array([0.55, 1.2, 5.0, 9.8, 10.5])).tolist() == [
        True, True, False, True, True,
    ]  # fmt: skip
    assert_allclose(readings.at(np.array([1.2, 9.8]))[:, 0], [0.1, 0.7])
    assert_allclose(readings.motion(np.array([1.2, 9.8]))[1], 0, atol=1e-12)
    assert not readings.available(np.array([-0.1, 11.5])).any()


def test_where_the_arm_moves_and_its_line_falls_silent_nothing_is_held() -> None:
    t = np.concatenate([np.arange(0, 1, 0.01), np.arange(3, 4, 0.01), [6.0, 8.0, 8.3]])
    moving = np.stack([wave(t), np.zeros(len(t))], axis=1)
    edges = np.array([1.05, 2.95, 4.05, 5.95, 6.05, 7.95, 8.15])
    # a single reading is a visit; of the last two, one says that the other's arm moves
    assert Readings(t, moving).available(edges).tolist() == [
        False, False, False, True, True, False, True,
    ]  # fmt: skip
    brakes = np.minimum(t, 0.3)[:, None]  # at rest long before the line fell silent
    assert Readings(t, brakes).available(edges).all()


def test_a_log_is_interpolated_across_no_gap_in_which_the_curve_misses_its_motion() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(0.0, 12.0, 0.01)
    t = t[((t < 3) | (t > 3.5)) & ((t < 6) | (t > 6.5))]

    def moving(at):
        rest = np.clip(at, None, 5.5)  # the second gap is at rest
        return np.stack([wave(rest), wave(rest, 0.5, 3.0)], axis=1)

    log = Readings.of_log(t, moving(t) + rng.normal(0, np.deg2rad(0.01), (len(t), 2)))
    at = np.arange(1.0, 11.0, 0.001)
    known = log.available(at)
    assert_allclose([at[~known].min(), at[~known].max()], [2.98, 3.52], atol=0.002)
    assert np.count_nonzero(~known) < 545
    assert np.abs(log.at(at[known]) - moving(at[known])).max() < np.deg2rad(0.06)
    lossy = t[rng.random(len(t)) > 0.1]  # single rows that are missing do no harm
    assert Readings.of_log(lossy, moving(lossy)).available(at).mean() > 0.94


def test_the_direction_of_travel_is_kept_at_rest_and_ignores_noise() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(0, 8, 0.02)
    path = np.interp(t, [0, 2, 4, 6, 8], np.deg2rad([0, 10, 10, -5, -5]))
    readings = Readings(t, (path + rng.normal(0, np.deg2rad(0.01), len(t)))[:, None])
    assert readings.direction(np.array([1.0, 3.0, 3.9, 5.0, 7.5]))[:, 0].tolist() == [
        1,
        1,
        1,
        -1,
        -1,
    ]


def test_thousands_of_readings_at_rest_show_no_direction_of_travel() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    noise = np.random.default_rng(5).normal(0.0, np.deg2rad(0.01), (len(t), 6))
    moved = np.deg2rad(5.0) * np.clip(t - 30.0, 0.0, 1.0)[:, None] + noise
    readings = Readings(t, moved)
    assert not readings.direction(np.array([0.0, 10.0, 29.5])).any()
    assert np.all(readings.direction(np.array([30.5, 31.5, 45.0, 59.9])) == 1)


def test_a_joint_that_turns_without_a_rest_changes_direction_where_its_speed_is_zero() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(0, 20, 0.02)
    readings = Readings(t, (0.2 * np.sin(t) + rng.normal(0, 2e-4, len(t)))[:, None])
    wrong = readings.direction(t)[:, 0] != np.sign(np.cos(t))
    # five turning points; the noise hides 0.1 s about each, 30 readings in all
    assert 0 < wrong.sum() <= 12


def test_uneven_readings_are_joined_by_the_cubic_that_scipy_draws_through_their_slopes() -> None:
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.uniform(0.005, 0.03, 400))
    q = np.stack([wave(t), wave(t, 0.5, 3.0)], axis=1)
    slopes = np.gradient(q, t, axis=0)
    for i, end in ((0, slice(0, 4)), (-1, slice(-4, None))):  # there, of the cubic through four
        slopes[i] = BarycentricInterpolator(t[end], q[end]).derivative(t[i])
    known = CubicHermiteSpline(t, q, slopes)
    there = np.concatenate([rng.uniform(t[0], t[-1], 500), t[[0, 7, -1]]])
    assert_allclose(Readings(t, q).at(there), known(there), rtol=0, atol=1e-14)
