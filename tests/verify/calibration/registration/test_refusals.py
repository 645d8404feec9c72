"""Readings of another robot, or in another order: refused with the candidates, not as a mirror."""

from pathlib import Path

import numpy as np
import pytest

import robots
from robots.transforms import rotation_exp
from tests.support.recorded import refusal
from verify.calibration.registration.refusals import refuse_other_robot
from verify.calibration.registration.start import RegistrationStart, start_registration
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError

FOLDER = Path("monday")
T = np.linspace(0.0, 12.0, 40)
NO_MIRROR = np.eye(4)
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def motion(arm: robots.Arm) -> Array:
    """All joints to and fro about a bent posture, each at its own rate, (40, 6)."""
    middle = np.deg2rad([20.0, -50.0, 60.0, 10.0, -70.0, 15.0])
    swing = np.deg2rad(18.0) * np.sin(np.outer(T, np.linspace(0.5, 1.4, 6)) + np.arange(6))
    return np.clip(middle + swing, arm.lower, arm.upper)


def placed(turn: tuple[float, float, float], place: tuple[float, float, float]) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_exp(np.array(turn)), place
    return pose


def judge(moved: robots.Arm, robot: str, q: Array, read: Array, mirror: Array = NO_MIRROR) -> None:
    """Judge `read` as readings of the robot while q of another was seen."""
    rig_T_base, flange_T_body = placed((0.7, 1.1, -0.4), (0.1, 0.6, 1.2)), np.eye(4)
    flange_T_body[:3, 3] = [0.03, -0.02, 0.05]
    seen = mirror @ rig_T_base @ robots.forward(moved, q) @ flange_T_body @ mirror
    readings = Readings(T, read)

    def restart(other: Readings) -> RegistrationStart:
        return start_registration(T, seen, robots.load(robot), other, 0.0)

    refuse_other_robot(restart(readings), FOLDER, robot, readings, restart)


def complaint(
    moved: robots.Arm, robot: str, q: Array, read: Array, mirror: Array = NO_MIRROR
) -> InputError:
    error = refusal(judge, moved, robot, q, read, mirror)
    assert f'"{robot}" is the robot that moved' in error.remedy
    assert "order" in error.remedy
    return error


@pytest.mark.parametrize("moved", ["iust_6r", "rv_3sd_melfa"])
def test_its_own_readings_are_taken_up_to_some_degrees_of_joint_error(moved: str) -> None:
    arm = robots.load(moved)
    q = motion(arm)
    judge(arm, moved, q, q + np.deg2rad([1.0, -1.5, 2.0, -1.0, 1.5, 2.0]))


@pytest.mark.parametrize(
    ("moved", "named"), [("rv_3sd_melfa", "iust_6r"), ("iust_6r", "rv_3sd_melfa")]
)
def test_another_robot_is_the_first_cause_named(moved: str, named: str) -> None:
    arm = robots.load(moved)
    q = motion(arm)
    assert "turns differently from its LEDs" in complaint(arm, named, q, q).found


def test_columns_in_another_order_are_named_as_cause() -> None:
    arm = robots.load("rv_3sd_melfa")
    q = motion(arm)
    complaint(arm, "rv_3sd_melfa", q, q[:, ::-1])
    for order, joints in (([1, 0, 2, 3, 4, 5], "1 and 2"), ([0, 1, 2, 3, 5, 4], "5 and 6")):
        with pytest.raises(InputError, match=f"joints {joints} exchanged fits"):
            judge(arm, "rv_3sd_melfa", q, q[:, order])


def test_radians_read_as_degrees_are_named_as_cause() -> None:
    arm = robots.load("iust_6r")
    q = motion(arm)
    error = refusal(judge, arm, "iust_6r", q, np.deg2rad(q), NO_MIRROR)
    assert "all joints taken as radians fits" in error.found
    assert "180/π" in error.remedy


def test_mirrored_leds_are_still_reported_as_mirrored() -> None:
    arm = robots.load("iust_6r")
    q = motion(arm)
    error = complaint(arm, "iust_6r", q, q, MIRROR)
    assert "mirror image" in error.found
    assert "shiny surface" in error.remedy
