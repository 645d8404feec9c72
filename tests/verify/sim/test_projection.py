import numpy as np
import pytest
from numpy.testing import assert_allclose

import robots
from tests.verify.sim.scenes import scene
from verify.rig import Camera
from verify.sim.bench import SimulatedCamera, build_camera
from verify.sim.lights import lights, spots
from verify.sim.scenario import CameraTable, Recording, RigTable, Uncertainty
from verify.sim.sessions import simulate

AWKWARD = CameraTable(
    focal_px=(1012.4, 1003.7),
    principal_point_px=(655.0, 341.0),
    distortion=(-0.12, 0.08, 0.002, -0.003, 0.05),
    pan_axis=(0.05, 0.99, -0.08),
    pan_zero_deg=1.7,
    mount_rotation_deg=(3.0, -2.0, 5.0),
    mount_offset_mm=(4.0, -6.0, 12.0),
)


def twin(camera: SimulatedCamera) -> Camera:
    """The same camera in the measurement's own code."""
    return Camera(
        camera.matrix,
        camera.distortion,
        camera.pan_center,
        camera.pan_axis,
        camera.pan_zero,
        camera.turntable_T_camera,
    )


@pytest.mark.parametrize("pan_deg", [-25.0, 0.0, 11.3])
def test_the_simulator_and_the_measurement_project_alike(pan_deg: float) -> None:
    camera = build_camera(AWKWARD, (1280, 720), -0.085)
    measured = twin(camera)
    pan = np.radians(pan_deg)
    rig_T_camera = measured.rig_T_camera(pan)
    rng = np.random.default_rng(1)
    inside = rng.uniform([-0.3, -0.18, 0.5], [0.3, 0.18, 0.9], (200, 3))
    points = inside @ rig_T_camera[:3, :3].T + rig_T_camera[:3, 3]
    assert_allclose(camera.project(points, pan), measured.project(inside), atol=1e-9)


def test_points_behind_the_camera_are_not_in_the_picture() -> None:
    camera = build_camera(CameraTable(), (1280, 720), 0.0)
    assert np.all(np.isnan(camera.project(np.array([[0.0, 0.0, -1.0]]), 0.0)))


def test_spots_are_where_rig_marker_and_truth_put_them() -> None:
    session = simulate(scene(rig=RigTable(bases="follow", left=AWKWARD, right=CameraTable())))
    arm = robots.load("iust_6r")
    for side, camera in enumerate((session.rig.left, session.rig.right)):
        seen = session.spots(side)
        for i in range(len(session)):
            q = session.world.joints(session.t[i, side])
            rig_T_flange = session.rig.rig_T_base @ robots.forward(arm, q)
            points = session.marker.leds @ rig_T_flange[:3, :3].T + rig_T_flange[:3, 3]
            camera_T_rig = np.linalg.inv(camera.rig_T_camera(session.pan[i, side]))
            predicted = camera.project(points @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3])
            assert_allclose(seen[i], predicted, atol=1e-8)


def test_any_arm_that_robots_knows_can_be_simulated() -> None:
    home = [0.0, -70.0, 80.0, -100.0, -80.0, 0.0]
    motion = type(scene().motion)(home_deg=home, amplitude_deg=[8.0] * 6)
    session = simulate(scene(robot="ur5", motion=motion))
    assert np.all(np.isfinite(session.spots(0)))


def test_a_rolling_shutter_takes_each_led_at_its_own_row() -> None:
    line_time = 3e-5
    rolling = CameraTable(line_time_s=line_time)
    session = simulate(scene(rig=RigTable(left=rolling, right=rolling)))
    still = simulate(scene())
    for i in range(len(session)):
        t, pan = float(session.t[i, 0]), float(session.true_pan[i, 0])
        seen = spots(session.world, 0, t, pan)
        for led, (_, row) in enumerate(seen):
            own = t + (row - 359.5) * line_time
            assert_allclose(spots(still.world, 0, own, pan)[led], seen[led], atol=1e-6)


def test_motion_blur_covers_the_path_of_the_exposure_evenly() -> None:
    exposed = CameraTable(exposure_s=0.02)
    session = simulate(scene(rig=RigTable(left=exposed, right=exposed)))
    t, pan = float(session.t[5, 0]), float(session.true_pan[5, 0])
    light = lights(session.world, 0, t, pan)[0]
    k = len(light.path)
    assert k > 2
    for j, point in enumerate(light.path):
        instant = t + 0.02 * ((j + 0.5) / k - 0.5)
        assert_allclose(point, spots(session.world, 0, instant, pan)[0], atol=1e-9)


def test_the_right_camera_fires_later_by_the_skew() -> None:
    session = simulate(
        scene(recording=Recording(pairs=200, rate_hz=10.0, skew_s=0.004, skew_jitter_s=0.0006))
    )
    skew = session.t[:, 1] - session.t[:, 0]
    assert abs(skew.mean() - 0.004) < 4 * 0.0006 / np.sqrt(200)
    assert 0.8 < skew.std() / 0.0006 < 1.2  # four standard errors of a spread from 200


def test_the_true_bases_lie_off_the_pan_readings_by_the_stated_spread() -> None:
    session = simulate(
        scene(
            recording=Recording(pairs=200, rate_hz=10.0),
            rig=RigTable(bases="follow"),
            uncertainty=Uncertainty(pan_deg=0.01),
        )
    )
    off = np.degrees(session.true_pan - session.pan)
    assert 0.85 < off.std() / 0.01 < 1.15  # four standard errors of a spread from 400
