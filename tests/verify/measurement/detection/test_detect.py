"""Spot centres against the Cramér-Rao bound, and what must never be reported."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2

from tests.support.leds.images import (
    PATCH,
    REACH,
    Sensor,
    Spot,
    centre_bound,
    picture,
    scattered,
    through_jpeg,
)
from verify.core.records import Array, Image, Spots
from verify.errors import InputError
from verify.measurement.detection.candidates import blob_search
from verify.measurement.detection.detect import detect
from verify.measurement.detection.kernels.entries import (
    Picture,
    SpotLimits,
    find_blobs,
    measure_spots,
)
from verify.measurement.detection.profile import profile_table

DISC = Spot(210, 0.6, radius=4.2)
CASES = {  # spot, black level and floor, DN
    "dim": (Spot(60, 2.0), 0.0, 6.0),
    "bright": (Spot(200, 2.5), 0.0, 6.0),
    "wide": (Spot(200, 3.0), 0.0, 6.0),
    "saturated": (Spot(600, 2.5), 0.0, 6.0),
    "far over": (Spot(1500, 3.0), 0.0, 6.0),
    "disc": (DISC, 0.0, 6.0),
    "dim disc": (Spot(60, 0.6, radius=3.5), 0.0, 6.0),
    "saturated disc": (Spot(400, 0.6, radius=4.2), 0.0, 6.0),
    "black under the clamp": (DISC, 3.5, 0.0),
}


def matched(spots: Spots, centres: Array) -> tuple[Array, Array]:
    """Index of the spot nearest each centre, and the error, (n, 2)."""
    error = spots.centre[None] - centres[:, None]
    nearest = np.argmin(np.linalg.norm(error, axis=-1), axis=1)
    return nearest, error[np.arange(len(centres)), nearest]


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_centres_reach_the_bound_and_the_claimed_covariance_is_the_scatter(name: str) -> None:
    spot, black, floor = CASES[name]
    sensor, rng = Sensor(black=black), np.random.default_rng(11)
    errors, claimed = [], []
    for _ in range(11):
        centres = scattered(4, 6, rng)
        spots = detect(picture([spot] * 24, centres, sensor, rng, floor=floor))
        nearest, error = matched(spots, centres)
        errors.append(error)
        claimed.append(np.diagonal(spots.covariance[nearest], axis1=1, axis2=2))
        assert not spots.merged[nearest].any()
        assert np.all(spots.saturated[nearest] == (spot.peak > 255))
    rms = np.sqrt(np.mean(np.square(errors)))
    bound = centre_bound(spot, floor, sensor)
    sigma = np.sqrt(np.mean(claimed))
    assert rms < 1.1 * bound  # 528 errors: their rms is known to 3 %
    assert sigma == pytest.approx(rms, rel=0.10)
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 4 * rms / 16  # 4 sigma of 264 errors' mean


@pytest.mark.parametrize("quality", [75, 90])
def test_the_centres_of_a_jpeg_scatter_as_claimed(quality: int) -> None:
    rng, normal = np.random.default_rng(21), []
    for spot in (DISC, Spot(200, 0.8, radius=2.5), Spot(210, 1.0, radius=4.2), Spot(200, 2.5)) * 3:
        centres = scattered(4, 6, rng)
        image = picture([spot] * 24, centres, Sensor(black=3.5), rng, floor=0.0)
        spots = detect(through_jpeg(image, quality), lossy=True)
        nearest, error = matched(spots, centres)
        claimed = np.sqrt(np.diagonal(spots.covariance[nearest], axis1=1, axis2=2))
        normal.append(error / claimed)
    within = np.mean(np.abs(normal) < 1.96)  # of 576: 1 % is one sigma; no shape is the others'
    assert within == pytest.approx(0.95, abs=0.03)


COARSE = gaussian_filter(np.random.default_rng(4).normal(size=(360, 640)), 12, mode="mirror")
TEXTURE = 50 + 50 * COARSE / np.abs(COARSE).max()
BRIGHT_ROOM = 120 + 80 * np.linspace(0, 1, 640)[None, :] + np.zeros((360, 640))


@pytest.mark.parametrize("floor", [6.0, TEXTURE], ids=["even", "texture"])
def test_four_leds_a_frame_suffice_to_know_their_uncertainty(floor: float | Array) -> None:
    sensor, rng = Sensor(read=2.0, gain=0.05), np.random.default_rng(5)
    spot, normal = Spot(150, 2.2), []
    for turn in range(60):
        centres = scattered(2, 2, rng, pitch=150.0)
        room = np.roll(floor, 3 * 640 * turn)  # another part of it under every LED
        spots = detect(picture([spot] * 4, centres, sensor, rng, floor=room))
        nearest, error = matched(spots, centres)
        whitened = np.linalg.solve(spots.covariance[nearest], error[..., None])[..., 0]
        normal.append(np.sum(whitened * error, axis=1) / 2)
    assert np.mean(normal) == pytest.approx(1.0, abs=0.15)  # 480 errors: 6.5 % is one sigma


def before_texture(
    leds: list[Spot],
    grain: float,
    depth: float,
    rng: np.random.Generator,
    quality: int | None = None,
) -> tuple[Array, Array]:
    """Errors (n, 2), px, of LEDs before a room, and over their uncertainties; NaN where merged.

    Texture of the room: its grain, px, and standard deviation, DN, about 50 DN. `quality`: of the
    JPEG that the picture is.
    """
    room = gaussian_filter(rng.normal(size=(360, 640)), grain / 2, mode="wrap")
    centres = scattered(2, len(leds) // 2, rng, pitch=110.0)
    image = picture(leds, centres, Sensor(), rng, floor=50 + depth * room / room.std())
    spots = detect(through_jpeg(image, quality) if quality else image, lossy=quality is not None)
    nearest, error = matched(spots, centres)
    error[spots.merged[nearest] | (np.abs(error).max(axis=1) > 5)] = np.nan  # or not found
    return error, error / np.sqrt(np.diagonal(spots.covariance[nearest], axis1=1, axis2=2))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grain", "depth", "quality"),
    [(12, 15, None), (6, 15, None), (12, 4, None), (24, 4, None), (12, 4, 90), (12, 4, 75)],
)
def test_small_and_large_leds_before_texture_scatter_as_claimed(
    grain: int, depth: int, quality: int | None
) -> None:
    rng, normal = np.random.default_rng(31), []
    for _ in range(200):
        peak = rng.uniform(100, 300)
        sizes = [*rng.uniform(2, 3.5, 2), *rng.uniform(4.5, 6, 2)]
        leds = [Spot(peak, rng.uniform(0.5, 1.0), radius) for radius in sizes]
        normal.append(before_texture(leds, grain, depth, rng, quality)[1])
    small, large = np.split(np.array(normal), 2, axis=1)
    for z in (small, large):  # 800 coordinates, two a spot alike: 1 % is one sigma
        within = np.mean(np.abs(z[np.isfinite(z)]) < 1.96)
        assert within == pytest.approx(0.95, abs=0.03)


def test_before_strong_texture_the_noise_is_that_of_the_camera() -> None:
    """What texture adds to residuals was taken for shot noise, and made it six times as large."""
    sensor, rng, of_room, of_leds = Sensor(), np.random.default_rng(41), [], []
    for _ in range(30):
        room = gaussian_filter(rng.normal(size=(360, 640)), 6, mode="wrap")
        leds = [Spot(200, 0.7, radius) for radius in rng.uniform(2, 6, 4)]
        floor = 50 + 15 * room / room.std()
        image = picture(leds, scattered(2, 2, rng, pitch=110.0), sensor, rng, floor=floor)
        noise = detect(image).noise
        of_room.append(noise.read**2 + noise.gain * (50 - noise.black))
        of_leds.append(noise.read**2 + noise.gain * (200 - noise.black))
    assert np.mean(of_room) == pytest.approx(sensor.read**2 + sensor.gain * 50, rel=0.1)
    assert np.mean(of_leds) == pytest.approx(sensor.read**2 + sensor.gain * 200, rel=0.25)


def test_a_saturated_disc_before_texture_is_not_taken_for_a_part_of_it() -> None:
    rng, errors, normal = np.random.default_rng(7), [], []
    for _ in range(60):
        leds = [Spot(rng.uniform(230, 300), 0.7, rng.uniform(4.5, 6)) for _ in range(8)]
        error, z = before_texture(leds, 12, 15, rng)
        errors.append(error)
        normal.append(z)
    # of a tenth, texture chooses the shape of the top: they are said to be merged
    assert np.mean(np.isfinite(errors)) > 0.85
    assert np.nanmax(np.abs(errors)) < 0.7  # a part of a disc is half its radius off
    assert np.nanmax(np.abs(normal)) < 7


def test_texture_beside_a_disc_gives_no_spot_on_its_rim() -> None:
    rng, off = np.random.default_rng(7), []
    for _ in range(60):
        leds = [Spot(rng.uniform(250, 400), 0.7, rng.uniform(6, 7.5)) for _ in range(8)]
        room = gaussian_filter(rng.normal(size=(360, 640)), 6, mode="wrap")
        centres = scattered(2, 4, rng, pitch=110.0)
        image = picture(leds, centres, Sensor(), rng, floor=50 + 15 * room / room.std())
        spots = detect(image, np.hstack([centres - 37, centres + 37]))
        apart = np.linalg.norm(spots.centre[:, None] - centres, axis=2).min(axis=1)
        off += apart[(apart < 9) & ~spots.merged].tolist()
    assert len(off) > 300
    assert max(off) < 0.7  # px; a rim is 6 from the centre


def test_a_room_that_slopes_across_a_spot_alone_moves_it_little() -> None:
    """Of a wave 20.3 px long, what is 12 px around a spot on it has no slope along the wave."""
    rng, errors = np.random.default_rng(4), []
    row, column = np.mgrid[:360, :640].astype(float)
    for _ in range(5):
        centres, room = scattered(3, 5, rng, pitch=110.0), np.full((360, 640), 50.0)
        for x, y in centres:
            near = np.hypot(column - x, row - y) < 45
            wave = 3 * np.sin(2 * np.pi * (column - x) / 20.3) + 0.6 * (row - y)
            room += near * wave
        spots = detect(picture([Spot(180, 0.6, 4.2)] * 15, centres, Sensor(), rng, floor=room))
        errors.append(matched(spots, centres)[1])
    assert np.abs(np.mean(np.concatenate(errors), axis=0)).max() < 0.025  # px


def test_windows_find_the_same_spots_as_the_whole_image() -> None:
    rng = np.random.default_rng(3)
    centres = scattered(2, 2, rng, pitch=150.0)
    image = picture([Spot(200, 2.5)] * 4, centres, Sensor(), rng)
    whole = detect(image)
    windows = np.hstack([centres[:3] - 20, centres[:3] + 20])
    some = detect(image, windows, noise=whole.noise)
    assert len(some) == 3
    nearest, _ = matched(whole, some.centre)
    np.testing.assert_allclose(some.centre, whole.centre[nearest], atol=3e-3)  # of 9e-3
    sigma, before = (np.diagonal(c, axis1=1, axis2=2) for c in (some.covariance, whole.covariance))
    np.testing.assert_allclose(sigma, before[nearest], rtol=0.05)  # the slopes' prior differs


def test_small_windows_in_one_call_give_what_their_candidates_give() -> None:
    rng = np.random.default_rng(12)
    centres = scattered(2, 2, rng, pitch=150.0)
    image = picture([DISC, Spot(200, 2.5), Spot(60, 2.0), Spot(600, 2.5)], centres, Sensor(), rng)
    (height, width), noise = image.shape, detect(image).noise
    windows = np.hstack([centres - 20, centres + 20]).round()
    blobs = find_blobs(image, windows.astype(np.int64), 0, blob_search(1))
    candidates = blobs[np.argsort(-blobs[:, 3], kind="stable")]
    known = np.array([noise.read**2, noise.gain, noise.black, 0.0]), False
    limits, kind = SpotLimits(2.0, 40.0, 24), (False, False)
    whole = Picture(image, width, height, 1)
    expected = measure_spots(whole, candidates, known, profile_table(), limits, kind)
    found = detect(image, windows, noise=noise)
    assert len(found) == 4
    for name, values in zip(Spots.__slots__, expected, strict=False):
        np.testing.assert_array_equal(getattr(found, name), values, err_msg=name)


def test_what_another_picture_left_in_memory_changes_nothing() -> None:
    """Rows of pixels are padded to whole vectors, in memory that is used again."""
    rng = np.random.default_rng(13)
    centres = scattered(2, 2, rng, pitch=150.0)
    small = picture([Spot(90, 1.2)] * 4, centres, Sensor(), rng)
    room = rng.uniform(20, 90, small.shape)
    large = picture([Spot(900, 7.0)] * 4, centres, Sensor(), rng, small.shape, room)
    first = detect(small)
    for image in (large, 255 - large):
        detect(image)
        again = detect(small)
        for name in Spots.__slots__:
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name))


@pytest.mark.parametrize(
    ("spot", "floor", "off"),
    [(Spot(60, 2.5), TEXTURE, 0.3), (Spot(200, 2.5), BRIGHT_ROOM, 0.15)],
    ids=["dim LEDs over texture", "a bright room"],
)
def test_leds_are_found_before_any_background(spot: Spot, floor: Array, off: float) -> None:
    rng = np.random.default_rng(4)
    centres = scattered(2, 4, rng, pitch=140.0)
    spots = detect(picture([spot] * 8, centres, Sensor(), rng, floor=floor))
    nearest, error = matched(spots, centres)
    assert np.abs(error).max() < off
    assert spots.saturated[nearest].all() == (spot.peak + floor.max() > 255)


@pytest.mark.parametrize("level", [0, 7, 128, 254, 255])
def test_an_image_without_contrast_has_no_spots(level: int) -> None:
    for shape in ((720, 1280), (720, 1280, 3), (4, 4), (2, 300)):
        assert len(detect(np.full(shape, level, dtype=np.uint8))) == 0


def test_spots_cut_by_the_border_are_not_returned() -> None:
    rng = np.random.default_rng(9)
    centres = np.array([[1.0, 100.0], [300.0, 358.5], [320.3, 180.2]])
    spots = detect(picture([Spot(200, 2.5)] * 3, centres, Sensor(), rng))
    assert len(spots) == 1
    assert np.abs(spots.centre[0] - centres[2]).max() < 0.1


@pytest.mark.parametrize("level", [40, 80, 160])
def test_a_disc_as_bright_as_a_level_of_the_search_is_found_whole(level: int) -> None:
    """Noise tears its top at that level; in a window, which is not searched at half size."""
    rng = np.random.default_rng(21)
    for peak in level + np.arange(-6.0, 7.0, 2.0):
        centres = scattered(2, 3, rng)
        image = picture([Spot(peak, 0.6, radius=9.0)] * 6, centres, Sensor(), rng, floor=2.0)
        spots = detect(image, np.hstack([centres - 32, centres + 32]))
        nearest, error = matched(spots, centres)
        u = np.sqrt(np.diagonal(spots.covariance[nearest], axis1=1, axis2=2))
        assert np.all(np.abs(error) < 5 * u)
        assert u.max() < 0.1
        assert spots.diameter[nearest] == pytest.approx(np.full(6, 18.0), abs=1.0)


def test_noise_streaks_and_windows_of_light_are_not_leds() -> None:
    rng, light = np.random.default_rng(7), np.full((360, 640), 100.0)
    assert len(detect(Sensor(read=3.0).expose(light, rng))) == 0
    light[:] = 6.0
    light[50:56, 100:300] = 200
    light[150:330, 400:560] = 220
    assert len(detect(Sensor().expose(light, rng))) == 0


ALONE = np.array([[120.3, 90.2], [500.1, 80.4], [130.7, 280.6], [520.2, 270.3]])
BLURRED = Spot(200, 2.2, radius=3.0)  # 6.7 px wide


@pytest.mark.parametrize(
    ("spot", "beside"),
    [(Spot(200, 0.6, radius=4.0), [5.5, 2.0]), (BLURRED, [3.8, 1.5]), (BLURRED, [10.5, 4.5])],
    ids=["sharp", "blurred", "blurred, told apart"],
)
def test_where_two_leds_overlap_the_covariance_holds_both(spot: Spot, beside: list[float]) -> None:
    rng, two = np.random.default_rng(12), np.add([300.3, 180.1], [[0, 0], beside])
    spots = detect(picture([spot] * 6, np.vstack([two, ALONE]), Sensor(), rng))
    nearest, error = matched(spots, two)
    apart = np.linalg.norm(beside) > 1.5 * spots.diameter[nearest[0]]
    assert np.all(spots.merged[nearest] != apart)
    squared = np.sum(
        error * np.linalg.solve(spots.covariance[nearest], error[..., None])[..., 0], 1
    )
    assert squared.max() < 9.2  # 99 %
    assert not apart or np.abs(error).max() < 0.06


@pytest.mark.parametrize("width", [0.6, 0.8, 1.0])  # of the LED, between the two
def test_a_dim_light_that_touches_a_blurred_led_is_in_its_covariance(width: float) -> None:
    """It stretches the LED, and the misfit that it leaves does not excuse that."""
    rng, dim = np.random.default_rng(15), Spot(40, BLURRED.blur, BLURRED.radius)
    for _ in range(8):
        side, led = rng.uniform(0, 2 * np.pi), np.array([300.3, 180.1]) + rng.uniform(-3, 3, 2)
        other = led + 6.7 * width * np.array([np.cos(side), np.sin(side)])
        image = picture([BLURRED] * 5 + [dim], np.vstack([ALONE, led, other]), Sensor(), rng)
        spots = detect(image)
        nearest, error = matched(spots, led[None])
        squared = error[0] @ np.linalg.solve(spots.covariance[nearest[0]], error[0])
        assert squared < 9.2  # 99 %
        assert not spots.merged[matched(spots, ALONE)[0]].any()


def test_a_hidden_part_is_flagged_or_in_the_covariance() -> None:
    rng = np.random.default_rng(13)
    light = 6 + Spot(200, 0.6, radius=4.5).light((101, 101), 50.2, 49.8)
    light[:, :48] = 6.0  # an edge before the left third of the LED
    spots = detect(Sensor().expose(light, rng))
    error = spots.centre - [50.2, 49.8]
    sigma = np.sqrt(np.diagonal(spots.covariance, axis1=1, axis2=2))
    assert np.all(spots.merged | np.all(np.abs(error) < 4 * sigma, axis=1))


def some_changed(
    spot: Spot, change: dict[str, tuple[float, float]], rng: np.random.Generator
) -> tuple[Image, Array]:
    """Picture of twelve LEDs, every third one changed by a random share, and their centres."""
    centres = scattered(2, 6, rng, pitch=100.0)
    light = np.full((360, 640), 6.0)
    for n, centre in enumerate(centres):
        x, y = np.rint(centre).astype(int)
        changed = {k: rng.uniform(*ends) for k, ends in change.items()} if n % 3 == 0 else {}
        at, side = centre - [x, y] + REACH, rng.uniform(0, 2 * np.pi)
        part = spot.part(PATCH, *at, side, **changed)
        light[y - REACH : y + REACH + 1, x - REACH : x + REACH + 1] += part
    return Sensor().expose(light, rng), centres


TINY, LARGE = Spot(220, 0.5, radius=1.9), Spot(200, 0.6, radius=4.2)


@pytest.mark.parametrize("spot", [TINY, LARGE], ids=["tiny", "large"])
@pytest.mark.parametrize("lossy", [False, True], ids=["raw", "JPEG"])
def test_an_edge_before_an_led_is_told_from_an_led_seen_at_an_angle(
    spot: Spot, lossy: bool
) -> None:
    rng, flagged = np.random.default_rng(17), {"hidden": [], "ratio": []}
    for kind, low, high in 6 * (("hidden", 0.2, 0.45), ("ratio", 0.6, 0.9)):
        image, centres = some_changed(spot, {kind: (low, high)}, rng)
        spots = detect(through_jpeg(image, 90) if lossy else image, lossy=lossy)
        nearest, _ = matched(spots, centres[::3])
        flagged[kind] += spots.merged[nearest].tolist()
    assert np.mean(flagged["hidden"]) > 0.9
    assert np.mean(flagged["ratio"]) < 0.1


@pytest.mark.parametrize("hidden", [(0.15, 0.25), (0.25, 0.35), (0.35, 0.5)])
def test_out_of_focus_an_edge_shows_in_the_covariance_though_not_in_the_shape(
    hidden: tuple[float, float],
) -> None:
    rng, within, flagged = np.random.default_rng(19), [], []
    for _ in range(6):
        image, centres = some_changed(BLURRED, {"hidden": hidden}, rng)
        spots = detect(image)
        nearest, error = matched(spots, centres)
        sigma = np.sqrt(np.diagonal(spots.covariance, axis1=1, axis2=2))[nearest]
        within.append(np.abs(error[::3]) < 1.96 * sigma[::3])
        flagged.append(np.delete(spots.merged[nearest], np.s_[::3]))
    assert np.mean(within) > 0.93
    assert np.mean(flagged) < 0.02


def test_texture_beside_a_small_led_does_not_cost_it_its_pixels() -> None:
    """The room's bright places are found as dim lights, which reach the LED's patch."""
    rng, spot, off = np.random.default_rng(23), Spot(200, 0.6, radius=2.2), []
    for _ in range(40):
        room = gaussian_filter(rng.normal(size=(360, 640)), 6.0, mode="wrap")
        centres = scattered(2, 2, rng, pitch=140.0)
        image = picture([spot] * 4, centres, Sensor(), rng, floor=50 + 15 * room / room.std())
        spots = detect(image, np.hstack([centres - 30, centres + 30]))
        _, error = matched(spots, centres)
        off += error[np.abs(error).max(axis=1) < 0.5].tolist()
    assert len(off) > 150  # of 160
    rms = np.sqrt(np.mean(np.square(off)))
    assert rms < 1.8 * centre_bound(spot, 50.0, Sensor())  # of an even room


def test_texture_full_of_dim_lights_widens_the_covariance() -> None:
    """Left out as lights, these are all that shows how far the room moves a centre."""
    rng, squared = np.random.default_rng(18), []
    for _ in range(15):
        room = gaussian_filter(rng.normal(size=(360, 640)), 3.0, mode="wrap")
        floor = 50 + 15 * room / room.std()
        centres = scattered(2, 2, rng, pitch=140.0)
        image = picture([Spot(170, 0.6, radius=5.0)] * 4, centres, Sensor(), rng, floor=floor)
        windows = np.hstack([centres - 30, centres + 30])
        spots = detect(through_jpeg(image, 90), windows, lossy=True)
        nearest, error = matched(spots, centres)
        whitened = np.linalg.solve(spots.covariance[nearest], error[..., None])[..., 0]
        squared += np.sum(whitened * error, axis=1).tolist()
    assert np.mean(np.array(squared) < chi2.ppf(0.95, 2)) > 0.85


@pytest.mark.parametrize("colour", [(0.0, 0.0, 1.0), (0.3, 1.0, 0.5), (1.0, 1.0, 1.0)])
def test_colour_images_give_the_colour_and_use_all_channels(colour: tuple[float, ...]) -> None:
    sensor, rng, spot = Sensor(), np.random.default_rng(14), Spot(180, 2.5)
    errors, claimed = [], []
    for _ in range(6):
        centres = scattered(4, 6, rng)
        planes = [
            picture([Spot(share * spot.peak, spot.blur)] * 24, centres, sensor, rng)
            for share in colour
        ]
        spots = detect(np.dstack(planes))
        nearest, error = matched(spots, centres)
        errors.append(error)
        claimed.append(np.diagonal(spots.covariance[nearest], axis1=1, axis2=2))
        seen = spots.colour[nearest].mean(axis=0)
        np.testing.assert_allclose(seen / seen.max(), colour, atol=0.04)
    bounds = [centre_bound(Spot(c * spot.peak, spot.blur), 6.0, sensor) for c in colour if c > 0]
    together = np.sum(np.array(bounds) ** -2.0) ** -0.5  # independent channels
    rms = np.sqrt(np.mean(np.square(errors)))
    assert rms < 1.15 * together  # 288 errors: 4.2 % is one sigma
    assert np.sqrt(np.mean(claimed)) == pytest.approx(rms, rel=0.15)


def test_a_grey_picture_in_three_channels_is_one_measurement() -> None:
    rng = np.random.default_rng(15)
    grey = picture([Spot(200, 2.5)], np.array([[320.2, 180.4]]), Sensor(), rng)
    one, three = detect(grey), detect(np.repeat(grey[..., None], 3, axis=2))
    np.testing.assert_allclose(three.covariance, one.covariance, rtol=1e-9)


def test_what_is_not_an_8_bit_picture_is_refused() -> None:
    with pytest.raises(InputError, match="8 bits"):
        detect(np.zeros((10, 10), dtype=np.uint16))
    with pytest.raises(InputError, match="windows"):
        detect(np.zeros((10, 10), dtype=np.uint8), np.zeros((2, 3)))


def test_a_patch_without_a_single_pixel_that_counts_is_no_spot_and_no_crash() -> None:
    flat = np.tile(np.array([255, 100, 100], np.uint8), 200 * 200)  # no pixel is clear in blue
    candidate, noise = np.array([[100.0, 100.0, 4.0, 20.0]]), np.array([1.5**2, 0.03, 0.0, 0.0])
    flat_picture, limits = Picture(flat, 200, 200, 3), SpotLimits(2.0, 40.0, 9)
    known, kind = (noise, False), (False, False)
    fields = measure_spots(flat_picture, candidate, known, profile_table(), limits, kind)
    assert len(fields[0]) == 0
