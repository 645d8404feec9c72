import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.special import j1

from tests.verify.sim.scenes import scene
from verify.records import Array
from verify.sim.lights import Light, lights
from verify.sim.render import Renderer, stamp
from verify.sim.scenario import ImageTable, Occlusion
from verify.sim.sessions import simulate


def disc(centre: Array, radius: float, peak: float = 200.0, hidden: float = 0.0) -> Light:
    return Light(np.atleast_2d(centre), radius * np.eye(2), peak, "white", hidden)


def moments(light: Light, blur_px: float) -> tuple[float, Array, Array]:
    """Total, centroid and second central moments along x and y of a rendered light."""
    (x0, y0), patch = stamp(light, blur_px)
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


def test_a_spot_seen_aslant_is_an_ellipse_of_the_right_axes() -> None:
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


def test_clean_pictures_have_their_centroids_where_the_leds_project() -> None:
    session = simulate(scene())
    renderer = session.renderers[0]
    for i in range(len(session)):
        t, pan = float(session.t[i, 0]), float(session.true_pan[i, 0])
        picture = renderer.clean(lights(session.world, 0, t, pan)).astype(float)
        for x, y in session.spots(0)[i]:
            left, top = int(x) - 12, int(y) - 12
            patch = picture[top : top + 25, left : left + 25]
            seen = [
                left + patch.sum(0) @ np.arange(25) / patch.sum(),
                top + patch.sum(1) @ np.arange(25) / patch.sum(),
            ]
            assert np.hypot(seen[0] - x, seen[1] - y) < 0.005


@pytest.mark.parametrize("background", [20.0, 120.0])
def test_noise_has_the_stated_variance(background: float) -> None:
    table = ImageTable(
        read_noise_dn=2.0, electrons_per_dn=8.0, black_level_dn=10.0, background_dn=background
    )
    image = Renderer(table, (640, 360), seed=1, side=0).render([], frame=0).astype(float)
    variance = 2.0**2 + background / 8.0 + 1 / 12  # the last from rounding to whole numbers
    assert image.var() == pytest.approx(variance, rel=0.012)  # 4 standard errors of 230,400 pixels
    assert image.mean() == pytest.approx(background + 10, abs=0.05)


def test_a_dark_room_drawn_sparsely_has_the_noise_that_every_pixel_would_have() -> None:
    table = ImageTable(read_noise_dn=1.5, black_level_dn=-3.5)
    renderer = Renderer(table, (1280, 720), seed=1, side=0)
    fast = np.concatenate([renderer.render([], frame).ravel() for frame in range(8)])
    rng = np.random.default_rng(0)
    slow = np.clip(np.rint(rng.normal(-3.5, 1.5, fast.size)), 0, 255)
    for level in (1, 2, 3):
        counted, expected = np.sum(fast == level), np.sum(slow == level)
        assert expected > 0
        assert abs(counted - expected) < 4.5 * np.sqrt(2 * expected) + 3  # two Poisson counts


def test_light_beyond_the_sensors_limit_stays_at_255_and_black_at_0() -> None:
    table = ImageTable(read_noise_dn=0.5)
    renderer = Renderer(table, (64, 64), seed=1, side=0)
    image = renderer.render([disc(np.array([32.0, 32.0]), 5.0, peak=900.0)], 0)
    assert image[32, 32] == 255
    assert image[5, 5] == 0


def test_a_colour_picture_shows_each_led_in_its_colour() -> None:
    table = ImageTable(colour=True)
    light = Light(np.array([[32.0, 32.0]]), 4 * np.eye(2), 200.0, "red", 0.0)
    image = Renderer(table, (64, 64), seed=1, side=0).render([light], 0)
    blue, green, red = image[32, 32].astype(int)
    assert image.shape == (64, 64, 3)
    assert red > 150 > 60 > green > blue - 30


def test_the_same_frame_has_the_same_bytes_and_others_have_other_noise() -> None:
    session, again = simulate(scene()), simulate(scene())
    assert_array_equal(session.image(1, 7), again.image(1, 7))
    assert_array_equal(session.image(1, 7), session.image(1, 7))
    dark = session.renderers[0]
    assert not np.array_equal(dark.render([], 1), dark.render([], 2))
    assert not np.array_equal(dark.render([], 1), session.renderers[1].render([], 1))


def test_an_occlusion_hides_its_share_of_the_led_in_its_frames_alone() -> None:
    occlusion = Occlusion(led="B", first=3, last=5, camera="left", share=0.5)
    session, free = simulate(scene(occlusion=[occlusion])), simulate(scene())

    def light_of_b(played: object, side: int, index: int) -> float:
        x, y = free.spots(side)[index, 1].astype(int)
        image = (session if played is session else free).image(side, index)
        return float(image[y - 12 : y + 13, x - 12 : x + 13].sum())

    assert light_of_b(session, 0, 4) / light_of_b(free, 0, 4) == pytest.approx(0.5, abs=0.05)
    assert light_of_b(session, 0, 2) == light_of_b(free, 0, 2)
    assert light_of_b(session, 1, 4) == light_of_b(free, 1, 4)


def test_a_turning_camera_sees_the_rooms_pattern_shift() -> None:
    table = ImageTable(background_dn=40.0, texture_dn=8.0, read_noise_dn=0.0)
    renderer = Renderer(table, (640, 360), seed=1, side=0)
    straight, turned = renderer.clean([], 0.0), renderer.clean([], 50.0)
    assert_array_equal(straight[:, 50:], turned[:, :-50])
    assert straight.std() == pytest.approx(8.0, rel=0.15)  # a few hundred grains make the pattern
