"""Every sensitivity against a refit with the parameter itself moved in the file's object."""

from dataclasses import replace

import numpy as np
import pytest

from robots.transforms import difference
from tests.support.scene import facing, make_marker, make_rig, move_camera, sight, turned
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement, Sighting
from verify.core.rig import Covariance, Rig
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import sensitivities, stated_systematics

NAMES = [
    *(f"{side}.{key}" for side in ("left", "right") for key in (
        "fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3", "pan_zero_deg",
        "mount_rx_deg", "mount_ry_deg", "mount_rz_deg", "mount_x_mm", "mount_y_mm", "mount_z_mm",
        "pan_center_x_mm", "pan_center_y_mm", "pan_center_z_mm", "pan_axis_rx_deg",
        "pan_axis_rz_deg")),
    *(f"robot_base.{key}" for key in ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")),
    *(f"led.{led}.{axis}_mm" for led in "ABCD" for axis in "xyz"),
]  # fmt: skip
STEP = 1e-6  # SI units: small against curvature, large against rounding


def moved(rig: Rig, marker: Marker, name: str, step: float) -> tuple[Rig, Marker]:
    head, _, key = name.partition(".")
    if head in ("left", "right"):
        return replace(rig, **{head: move_camera(getattr(rig, head), key, step)}), marker
    if head == "robot_base":
        base = rig.rig_T_base.copy()
        if key.startswith("r"):
            base[:3, :3] = turned(base[:3, :3], key[1], step)
        else:
            base[:3, 3] += step * np.eye(3)["xyz".index(key[0])]
        return replace(rig, rig_T_base=base), marker
    leds = marker.leds.copy()
    if head == "led":
        leds[marker.names.index(key[0])] += step * np.eye(3)["xyz".index(key[2])]
    elif key.startswith("r"):
        leds = leds @ turned(np.eye(3), key[1], step).T
    else:
        leds = leds + step * np.eye(3)["xyz".index(key[0])]
    return rig, replace(marker, leds=leds)


def by_refit(
    rig: Rig, marker: Marker, views: tuple[Sighting, Sighting], start: Array, name: str
) -> Array:
    ends = []  # base_T_flange
    for sign in (1, -1):
        there = moved(rig, marker, name, sign * STEP)
        fitted = fit_pose(*views, *there, start)
        ends.append(np.linalg.inv(there[0].rig_T_base) @ fitted.rig_T_flange)
    return difference(*ends) / (2 * STEP)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*NAMES, *(f"body.{k}" for k in (
    "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"))])  # fmt: skip
def test_a_sensitivity_is_what_a_refit_with_the_parameter_moved_shows(name: str) -> None:
    covariance = Covariance(tuple(NAMES), np.ones(len(NAMES)), np.eye(len(NAMES)))
    rig = replace(make_rig(), covariance=covariance)
    marker = make_marker(body_standard_uncertainty=np.ones(6))
    truth = facing(0.04, -0.02, 0.6)
    views = sight(rig, marker, truth, 0.02, np.random.default_rng(11))
    pose = fit_pose(*views, rig, marker, truth)
    seen = Measurement(0, 0.0, "measured", 4, pose, *views)
    parameters = stated_systematics(rig, marker, turning=False)
    column = sensitivities(parameters, seen, rig, marker)[:, parameters.names.index(name)]
    expected = by_refit(rig, marker, views, pose.rig_T_flange, name)
    # first order: residuals of the noise and curvature leave a share of a percent
    assert np.linalg.norm(column - expected) < 0.01 * np.linalg.norm(expected)


def test_an_unknown_name_is_returned() -> None:
    covariance = Covariance(("left.fx_px", "left.zoom"), np.array([0.3, 1.0]), np.eye(2))
    parameters = stated_systematics(
        replace(make_rig(), covariance=covariance), make_marker(), turning=False
    )
    assert parameters.names == ("left.fx_px",)
    assert parameters.unknown == ("left.zoom",)


def test_what_is_not_stated_is_listed_as_taken_as_exact() -> None:
    marker = make_marker(led_standard_uncertainty=5e-5)
    assert stated_systematics(make_rig(), marker, turning=True).uncounted == (
        "rig", "robot base", "LED body", "apparent LED centre", "pan angle", "robot table",
    )  # fmt: skip


def test_axes_that_no_base_turned_about_are_taken_as_exact_once_bases_turn() -> None:
    def uncounted(*parameters: str, turning: bool) -> tuple[str, ...]:
        of = len(parameters)
        covariance = Covariance(parameters, np.ones(of), np.eye(of))
        rig = replace(make_rig(), covariance=covariance)
        return stated_systematics(rig, make_marker(), turning=turning).uncounted

    assert "pan axes" in uncounted("left.fx_px", turning=True)
    assert "pan axes" not in uncounted("left.fx_px", turning=False)
    assert "pan axes" not in uncounted("left.fx_px", "left.pan_axis_rx_deg", turning=True)
    assert "pan axes" not in uncounted("robot_base.x_mm", turning=True)  # the rig is named whole
