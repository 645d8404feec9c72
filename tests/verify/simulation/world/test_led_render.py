import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import j1

import robots
from tests.support.leds.truth import led_images, true_spots
from tests.support.simulated import AWKWARD, played
from verify.core.records import Array
from verify.core.rig import Camera
from verify.simulation.scenario import (
    Occlusion,
    ScenarioCamera,
    ScenarioImage,
    ScenarioRecording,
    ScenarioRig,
    ScenarioUncertainty,
)
from verify.simulation.world.bench import SimulatedCamera, build_camera
from verify.simulation.world.led_render import (
    Light,
    Renderer,
    render_light,
    visible_lights,
)


def twin(camera: SimulatedCamera) -> Camera:
    """The same camera in the measurement's own code."""
    return Camera(
        camera.matrix, camera.distortion, camera.pan_center, camera.pan_axis, camera.pan_zero,
        camera.turntable_T_camera,
    )  # fmt: skip


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
    camera = build_camera(ScenarioCamera(), (1280, 720), 0.0)
    assert np.all(np.isnan(camera.project(np.array([[0.0, 0.0, -1.0]]), 0.0)))


def test_spots_are_where_rig_marker_and_truth_put_them() -> None:
    session = played(rig=ScenarioRig(bases="follow", left=AWKWARD, right=ScenarioCamera()))
    arm = robots.load("iust_6r")
    for side, camera in enumerate((session.rig.left, session.rig.right)):
        seen = true_spots(session, side)
        for i in range(len(session)):
            q = session.world.joints(session.t[i, side])
            rig_T_flange = session.rig.rig_T_base @ robots.forward(arm, q)
            points = session.marker.leds @ rig_T_flange[:3, :3].T + rig_T_flange[:3, 3]
            camera_T_rig = np.linalg.inv(camera.rig_T_camera(session.pan[i, side]))
            predicted = camera.project(points @ camera_T_rig[:3, :3].T + camera_T_rig[:3, 3])
            assert_allclose(seen[i], predicted, atol=1e-8)


def test_a_rolling_shutter_takes_each_led_at_its_own_row() -> None:
    line_time = 3e-5
    rolling = ScenarioCamera(line_time_s=line_time)
    session = played(rig=ScenarioRig(left=rolling, right=rolling))
    still = played()
    for i in range(len(session)):
        t, pan = float(session.t[i, 0]), float(session.true_pan[i, 0])
        seen = led_images(session.world, 0, t, pan)
        for led, (_, row) in enumerate(seen):
            own = t + (row - 359.5) * line_time
            assert_allclose(led_images(still.world, 0, own, pan)[led], seen[led], atol=1e-6)


def test_motion_blur_covers_the_path_of_the_exposure_evenly() -> None:
    exposed = ScenarioCamera(exposure_s=0.02)
    session = played(rig=ScenarioRig(left=exposed, right=exposed))
    t, pan = float(session.t[5, 0]), float(session.true_pan[5, 0])
    light = visible_lights(session.world, 0, t, pan)[0]
    k = len(light.path)
    assert k > 2
    for j, point in enumerate(light.path):
        instant = t + 0.02 * ((j + 0.5) / k - 0.5)
        assert_allclose(point, led_images(session.world, 0, instant, pan)[0], atol=1e-9)


def test_the_right_camera_fires_later_by_the_skew() -> None:
    session = played(
        recording=ScenarioRecording(pairs=200, rate_hz=10.0, skew_s=0.004, skew_jitter_s=0.0006)
    )
    skew = session.t[:, 1] - session.t[:, 0]
    assert abs(skew.mean() - 0.004) < 4 * 0.0006 / np.sqrt(200)
    assert 0.8 < skew.std() / 0.0006 < 1.2  # four standard errors of a spread from 200


def test_the_true_bases_lie_off_the_pan_readings_by_the_stated_spread() -> None:
    session = played(
        recording=ScenarioRecording(pairs=200, rate_hz=10.0),
        rig=ScenarioRig(bases="follow"),
        uncertainty=ScenarioUncertainty(pan_deg=0.01),
    )
    off = np.degrees(session.true_pan - session.pan)
    assert 0.85 < off.std() / 0.01 < 1.15  # four standard errors of a spread from 400


def disc(centre: Array, radius: float, peak: float = 200.0, hidden: float = 0.0) -> Light:
    return Light(np.atleast_2d(centre), radius * np.eye(2), peak, "white", hidden)


def moments(light: Light, blur_px: float) -> tuple[float, Array, Array]:
    """Total, centroid and second central moments along x and y of a rendered light."""
    (x0, y0), patch = render_light(light, blur_px)
    patch = patch.astype(float)
    x, y = x0 + np.arange(patch.shape[1]), y0 + np.arange(patch.shape[0])
    total = patch.sum()
    centre = np.array([patch.sum(0) @ x, patch.sum(1) @ y]) / total
    spread = np.array([patch.sum(0) @ (x - centre[0]) ** 2, patch.sum(1) @ (y - centre[1]) ** 2])
    return total, centre, spread / total


@pytest.mark.parametrize("radius", [0.4, 0.8, 1.5, 3.5, 8.0])
@pytest.mark.parametrize("blur_px", [0.4, 0.6, 1.2])
def test_a_spots_centroid_light_and_width_are_right_wherever_it_falls(
    radius: float, blur_px: float
) -> None:
    # Sampling by pixels moves a centroid by the spectrum at one cycle a pixel, over pi: nothing
    # for common spots, 0.006 px for the smallest and sharpest one here.
    spectrum = abs(2 * j1(2 * np.pi * radius) / (2 * np.pi * radius))
    aliasing = spectrum * np.exp(-2 * (np.pi * blur_px) ** 2) / np.pi
    rng = np.random.default_rng(3)
    for centre in rng.uniform(100, 101, (12, 2)):
        total, seen, spread = moments(disc(centre, radius), blur_px)
        assert np.abs(seen - centre).max() < 1e-4 + 1.1 * aliasing
        assert total == pytest.approx(200 * np.pi * radius**2, rel=1e-4)
        # a disc's own second moment is r²/4, a pixel's 1/12; variances add
        width = radius**2 / 4 + blur_px**2 + 1 / 12
        assert spread == pytest.approx(width, abs=0.015 * width + 4 * aliasing)


def test_an_inclined_led_is_an_ellipse_of_the_right_axes() -> None:
    light = Light(np.array([[50.3, 60.8]]), np.array([[4.0, 0.0], [0.0, 2.0]]), 200.0, "white")
    total, centre, spread = moments(light, 0.6)
    assert np.abs(centre - [50.3, 60.8]).max() < 1e-3
    assert total == pytest.approx(200 * np.pi * 8, rel=0.01)
    assert spread - 0.36 - 1 / 12 == pytest.approx([4.0, 1.0], rel=0.01)


def test_motion_blur_widens_a_spot_along_its_path_only() -> None:
    steps = 20
    along = (np.arange(steps) + 0.5) / steps - 0.5
    path = np.array([50.2, 50.7]) + 6.0 * along[:, None] * [1.0, 0.0]
    total, centre, spread = moments(Light(path, 2 * np.eye(2), 200.0, "white"), 0.6)
    still = moments(disc(np.array([50.2, 50.7]), 2.0), 0.6)
    assert np.abs(centre - still[1]).max() < 1e-3
    assert total == pytest.approx(still[0], rel=1e-6)
    # a uniform path of length L adds L²/12; of 20 points, (1 - 1/400) of that
    assert spread - still[2] == pytest.approx([3.0 * (1 - 1 / 400), 0.0], abs=0.01)


@pytest.mark.parametrize("background", [20.0, 120.0])
def test_noise_has_the_stated_variance(background: float) -> None:
    table = ScenarioImage(
        read_noise_dn=2.0, electrons_per_dn=8.0, black_level_dn=10.0, background_dn=background
    )
    image = Renderer(table, (640, 360), seed=1, side=0).render([], frame=0).astype(float)
    variance = 2.0**2 + background / 8.0 + 1 / 12  # the last from rounding to whole numbers
    assert image.var() == pytest.approx(variance, rel=0.012)  # 4 standard errors of 230,400 pixels
    assert image.mean() == pytest.approx(background + 10, abs=0.05)


def test_a_dark_room_drawn_sparsely_has_the_noise_that_every_pixel_would_have() -> None:
    table = ScenarioImage(read_noise_dn=1.5, black_level_dn=-3.5)
    renderer = Renderer(table, (1280, 720), seed=1, side=0)
    fast = np.concatenate([renderer.render([], frame).ravel() for frame in range(8)])
    rng = np.random.default_rng(0)
    slow = np.clip(np.rint(rng.normal(-3.5, 1.5, fast.size)), 0, 255)
    for level in (1, 2, 3):
        counted, expected = np.sum(fast == level), np.sum(slow == level)
        assert expected > 0
        assert abs(counted - expected) < 4.5 * np.sqrt(2 * expected) + 3  # two Poisson counts


def test_light_beyond_the_sensors_limit_stays_at_255_and_black_at_0() -> None:
    table = ScenarioImage(read_noise_dn=0.5)
    renderer = Renderer(table, (64, 64), seed=1, side=0)
    image = renderer.render([disc(np.array([32.0, 32.0]), 5.0, peak=900.0)], 0)
    assert image[32, 32] == 255
    assert image[5, 5] == 0


def test_a_colour_picture_shows_each_led_in_its_colour() -> None:
    table = ScenarioImage(colour=True)
    light = Light(np.array([[32.0, 32.0]]), 4 * np.eye(2), 200.0, "red", 0.0)
    image = Renderer(table, (64, 64), seed=1, side=0).render([light], 0)
    blue, green, red = image[32, 32].astype(int)
    assert image.shape == (64, 64, 3)
    assert red > 150 > 60 > green > blue - 30


def test_the_same_frame_has_the_same_bytes_and_others_have_other_noise() -> None:
    session, again = played(), played()
    assert_array_equal(session.image(1, 7), again.image(1, 7))
    assert_array_equal(session.image(1, 7), session.image(1, 7))
    dark = session.renderers[0]
    assert not np.array_equal(dark.render([], 1), dark.render([], 2))
    assert not np.array_equal(dark.render([], 1), session.renderers[1].render([], 1))


def test_an_occlusion_hides_its_share_of_the_led_in_its_frames_alone() -> None:
    occlusion = Occlusion(led="B", first=3, last=5, camera="left", share=0.5)
    session, free = played(occlusion=[occlusion]), played()

    def light_of_b(played: object, side: int, index: int) -> float:
        x, y = true_spots(free, side)[index, 1].astype(int)
        image = (session if played is session else free).image(side, index)
        return float(image[y - 12 : y + 13, x - 12 : x + 13].sum())

    assert light_of_b(session, 0, 4) / light_of_b(free, 0, 4) == pytest.approx(0.5, abs=0.05)
    assert light_of_b(session, 0, 2) == light_of_b(free, 0, 2)
    assert light_of_b(session, 1, 4) == light_of_b(free, 1, 4)


def test_a_turning_camera_shifts_the_background() -> None:
    table = ScenarioImage(background_dn=40.0, texture_dn=8.0, read_noise_dn=0.0)
    renderer = Renderer(table, (640, 360), seed=1, side=0)
    straight, turned = renderer._view(0.0), renderer._view(50.0)
    assert_array_equal(straight[:, 50:], turned[:, :-50])
    assert straight.std() == pytest.approx(8.0, rel=0.15)  # a few hundred grains make the pattern
