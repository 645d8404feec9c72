"""Limits of the joints, and words for what would break them."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.verify.grab.planned_cell import melfa
from verify.grab.limits import Motion, at_rest, joint_limits, violation
from verify.records import Array

LIMITS = joint_limits(melfa(), 0.5)


def test_the_share_is_of_each_rate_and_of_no_position() -> None:
    assert_allclose(np.degrees(LIMITS.speed[0]), 125)
    assert_allclose(LIMITS.jerk, 0.5 * np.radians([20000, 14960, 20000, 32960, 32960, 52800]))
    assert_allclose(LIMITS.upper, melfa().upper)


def changed(key: str, joint: int, value: float) -> Motion:
    motion = at_rest(np.array([0, 0, 1, 0, 0.5, 0.0]))
    values: Array = getattr(motion, key).copy()
    values[joint] = value
    return dataclasses.replace(motion, **{key: values})


@pytest.mark.parametrize(
    ("key", "joint", "value", "words"),
    [
        ("q", 2, np.radians(-20.5), "joint 3 would stand at -20.5°, allowed is -20 to 171°"),
        ("q", 0, np.nan, "joint 1 would stand at nan°"),
        ("velocity", 1, -2.0, "joint 2 would turn at -114.6°/s"),
        ("velocity", 4, np.inf, "joint 5 would turn at inf°/s"),
        ("acceleration", 5, 30.0, "joint 6 would speed up by 1718.9°/s²"),
    ],
)
def test_what_breaks_a_limit_is_said(key: str, joint: int, value: float, words: str) -> None:
    assert violation(LIMITS, changed("q", 0, 0.0)) == ""
    assert words in violation(LIMITS, changed(key, joint, value))


def test_one_instant_among_many_is_found() -> None:
    many = Motion(*(np.tile(v, (5, 1)) for v in dataclasses.astuple(changed("q", 0, 0.0))))
    assert violation(LIMITS, many) == ""
    many.q[3, 3] = 3.0
    assert violation(LIMITS, many).startswith("joint 4 would stand at 171.9°")


def test_a_limit_itself_is_allowed_but_for_rounding() -> None:
    for q in (LIMITS.lower, LIMITS.upper, LIMITS.upper + 1e-9):
        assert violation(LIMITS, at_rest(q)) == ""
    assert violation(LIMITS, at_rest(LIMITS.upper + 1e-4))
