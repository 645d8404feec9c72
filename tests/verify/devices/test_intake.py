import numpy as np
import pytest

from tests.verify.devices.bench import same_angles
from verify.devices.controller_clock import Instant
from verify.devices.intake import LEAP, AngleMap, Counts, Intake
from verify.errors import InputError


def take(intake: Intake, t: float, degrees: float) -> int:
    return len(intake.take(Instant(t, 0), t, 0.0, np.deg2rad([degrees, 0.0])))


def test_a_leap_that_no_arm_can_make_is_dropped_alone() -> None:
    counts = Counts()
    intake = Intake(same_angles(2), counts)
    taken = [take(intake, 0.01 * i, 90.0 if i == 7 else 0.1 * i) for i in range(20)]
    assert taken == [1] * 7 + [0] + [1] * 12
    assert counts.bad[LEAP] == 1


def test_a_leap_that_stays_is_believed() -> None:
    intake = Intake(same_angles(2), Counts())
    assert [take(intake, 0.01 * i, 0.0 if i < 3 else 90.0) for i in range(10)] == [
        1, 1, 1, 0, 0, 0, 0, 1, 1, 1,
    ]  # fmt: skip


def test_the_quickest_joint_of_the_rv_3sd_and_a_turn_past_zero_are_no_leaps() -> None:
    intake = Intake(same_angles(2), Counts())
    assert all(take(intake, 0.01 * i, 660.0 * 0.01 * i) for i in range(50))
    intake = Intake(same_angles(2), Counts())
    assert all(take(intake, 0.01 * i, (358.0 + i) % 360) for i in range(10))


def test_sign_and_zero_are_the_robot_files() -> None:
    angles = AngleMap(np.array([1.0, -1.0]), np.deg2rad([0.0, 90.0]))
    np.testing.assert_allclose(angles.joint_angles(np.deg2rad([10.0, 20.0])), np.deg2rad([10, 70]))
    for sign, offset in (([1.0, 0.5], [0.0, 0.0]), ([1.0], [0.0, 0.0]), ([1.0], [np.nan])):
        with pytest.raises(InputError):
            AngleMap(np.array(sign), np.array(offset))
