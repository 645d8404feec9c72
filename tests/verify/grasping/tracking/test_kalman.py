"""The Kalman track against the process it claims to follow, and against least squares."""

import numpy as np
import pytest

from verify.core.records import Array
from verify.grasping.tracking.kalman import (
    VELOCITY_TIME_CONSTANT,
    KalmanTrack,
    begin_track,
    distances,
)

SIGMA = 0.003  # m
NOISE = np.eye(3) * SIGMA**2
ORIGIN = np.zeros(3)


def test_the_prediction_has_the_moments_of_the_simulated_process() -> None:
    rng = np.random.default_rng(1)
    speed, spread, count, span, steps = 0.4, 0.01, 20000, 0.8, 400
    start = KalmanTrack(
        0.0, np.array([0.1, 0.3]), np.diag([spread**2, 0.04]), speed=speed, fastest=speed
    )
    x = rng.normal(0.1, spread, count)
    v = rng.normal(0.3, 0.2, count)
    dt = span / steps
    for _ in range(steps):  # dv = -v dt / VELOCITY_TIME_CONSTANT + noise, by Euler and Maruyama
        x += v * dt
        v += -v * dt / VELOCITY_TIME_CONSTANT + rng.normal(
            0, speed * np.sqrt(2 * dt / VELOCITY_TIME_CONSTANT), count
        )
    after = start.at(span)
    np.testing.assert_allclose(after.mean, [x.mean(), v.mean()], atol=0.01)
    np.testing.assert_allclose(after.covariance, np.cov(x, v), rtol=0.05, atol=1e-3)


def begun(position: Array = ORIGIN, speed: float = 0.5) -> KalmanTrack:
    return begin_track(0.0, position, NOISE, speed)


def rested(pairs: int) -> KalmanTrack:
    """A target that was measured at one place at 30 Hz."""
    track = begun()
    for i in range(1, pairs):
        track = track.at(i / 30).updated(np.zeros(3), NOISE).learned(1 / 30)
    return track


def test_two_steps_predict_as_one_does() -> None:
    track = begun(np.array([0.1, -0.2, 0.7]))
    once, twice = track.at(0.5), track.at(0.2).at(0.5)
    np.testing.assert_allclose(twice.mean, once.mean, atol=1e-12)
    np.testing.assert_allclose(twice.covariance, once.covariance, atol=1e-12)
    assert once.at(0.4) is once  # nothing goes back in time


def test_standing_still_it_becomes_the_mean_of_what_was_measured() -> None:
    rng = np.random.default_rng(4)
    place, measured = np.array([0.05, 0.02, 0.7]), []
    track = begun(place + rng.normal(0, SIGMA, 3), 1e-9)
    for i in range(1, 40):
        measured.append(place + rng.normal(0, SIGMA, 3))
        track = track.at(i / 30).updated(measured[-1], NOISE)
    assert np.sqrt(np.trace(track.position_covariance) / 3) == pytest.approx(
        SIGMA / np.sqrt(40), rel=0.02
    )


def filtered(path: Array, rng: np.random.Generator) -> Array:
    """Normalised squared errors of position along a path sampled at 30 Hz."""
    track = begun(path[0] + rng.normal(0, SIGMA, 3))
    errors = []
    for i, place in enumerate(path[1:], start=1):
        track = track.at(i / 30).updated(place + rng.normal(0, SIGMA, 3), NOISE)
        off = track.position - place
        errors.append(off @ np.linalg.solve(track.position_covariance, off))
    return np.array(errors)


def test_the_claimed_covariance_covers_a_target_that_is_carried_about() -> None:
    t = np.arange(90) / 30
    path = np.stack([0.1 * np.sin(3 * t), 0.02 * np.cos(2 * t), 0.7 + 0.05 * np.sin(2 * t)], axis=1)
    rng = np.random.default_rng(7)
    errors = np.concatenate([filtered(path, rng)[10:] for _ in range(30)])
    assert 1.0 < errors.mean() < 4.0  # 3 where covariance and scatter agree


def test_a_target_at_rest_gets_a_small_process_noise() -> None:
    track = rested(120)
    assert track.speed < 0.2
    assert track.at(4.7).position_covariance[0, 0] < begun().at(0.7).position_covariance[0, 0]


def test_a_push_explains_what_neither_rest_nor_its_usual_motion_does() -> None:
    ways, far = rested(60).explanations(2.0), np.array([0.03, 0, 0])
    likely = np.sum(distances([way.track for way in ways], far, NOISE), axis=0)
    costs = likely + [way.cost for way in ways]
    assert [way.abrupt for way in ways] == [False, False, True]
    assert costs[2] < min(costs[:2])
