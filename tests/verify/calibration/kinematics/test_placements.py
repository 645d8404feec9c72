"""The rig in which `verify identify` puts the robot where it was found."""

from dataclasses import replace

import numpy as np

import robots
from tests.support.scene import make_rig
from verify.calibration.kinematics.chain import ArmState, chain_of, registration_parameters
from verify.calibration.kinematics.fit import KinematicFit
from verify.calibration.kinematics.noise import NoiseScale
from verify.calibration.kinematics.placements import moved_rig
from verify.core.rig import Covariance

BASE_U = np.array([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3])  # m, rad


def placed(turn_deg: float) -> KinematicFit:
    """A base that was found turned about z, and nothing else."""
    base = np.eye(4)
    c, s = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    base[:2, :2] = [[c, -s], [s, c]]
    state = ArmState(chain_of(robots.load("iust_6r")), base[None], np.eye(4)[None])
    parameters = tuple(registration_parameters(1, 0, position_only=False))
    return KinematicFit(
        parameters, np.zeros(6), np.diag(BASE_U**2), np.eye(6), state, NoiseScale(1.0, 1.0),
        np.zeros(1), np.ones(1, dtype=bool),
    )  # fmt: skip


def test_a_moved_rig_keeps_what_its_cameras_state() -> None:
    names = ("left.fx_px", "robot_base.x_mm", "right.mount_ry_deg")
    correlation = np.eye(3)
    correlation[0, 2] = correlation[2, 0] = 0.6
    stated = Covariance(names, np.array([0.3, 9.0, 0.02]), correlation, 7.0, 21.5)
    rig = replace(make_rig(), rig_T_base=np.eye(4), covariance=stated)
    moved = moved_rig(rig, placed(90.0), 0)
    found = moved.covariance
    assert found is not None
    assert (found.degrees_of_freedom, found.temperature_c) == (7.0, 21.5)
    assert found.parameters[:2] == (names[0], names[2])
    np.testing.assert_allclose(found.correlation[:2, :2], correlation[::2, ::2], atol=1e-12)
    expected = [0.3, 0.02, *(BASE_U[[1, 0, 2]] * 1e3), *np.rad2deg(BASE_U[[4, 3, 5]])]
    np.testing.assert_allclose(found.standard_uncertainty, expected, rtol=1e-9)


def test_a_moved_rig_that_stated_nothing_states_its_base() -> None:
    rig = replace(make_rig(), rig_T_base=np.eye(4), covariance=None)
    found = moved_rig(rig, placed(0.0), 0).covariance
    assert found is not None
    assert found.parameters == tuple(f"robot_base.{a}_mm" for a in "xyz") + tuple(
        f"robot_base.r{a}_deg" for a in "xyz"
    )
