"""The noise that is kept from pair to pair, against the sensor that made the pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.support.leds.images import Sensor, Spot, picture
from verify.core.records import Noise, Spots, StereoPair
from verify.measurement.detection.pair import (
    ESTIMATE_EVERY,
    EVERYWHERE,
    FIRST_PICTURES,
    CameraNoise,
    PairNoise,
    PairSpots,
    Windows,
    detect_in_turn,
    find_spots,
)

CENTRES = np.array([[80.2, 90.4], [300.6, 95.1], [90.7, 250.3], [310.1, 260.8]])
LEDS = [Spot(peak, 1.6) for peak in (90, 150, 200, 230)]
BOXES = np.hstack([CENTRES - 25, CENTRES + 25])
WINDOWS: Windows = (BOXES, BOXES)
SIGNAL = 60.0  # DN, on an LED's flank, where its centre is told
QUIET, NOISY = Sensor(read=1.2, gain=1 / 60), Sensor(read=2.4, gain=1 / 15)


@dataclass
class Counter:
    """Finds the spots, and keeps what noise it was given."""

    given: list[PairNoise] = field(default_factory=list)

    def __call__(self, pair: StereoPair, windows: Windows, noise: PairNoise) -> tuple[Spots, Spots]:
        self.given.append(noise)
        return detect_in_turn(pair, windows, noise)


def pair_of(sensors: Sequence[Sensor], rng: np.random.Generator) -> StereoPair:
    images = [picture(LEDS, CENTRES, sensor, rng, floor=12.0) for sensor in sensors]
    return StereoPair(0, 0.0, 0.0, 0.0, 0.0, images[0], images[1])


def found_in_turn(
    sensors: list[tuple[Sensor, Sensor]], detector: Counter, windows: Windows = WINDOWS
) -> Iterator[PairSpots]:
    """Find the spots of pairs that two such sensors take, one pair after the other."""
    rng, noise = np.random.default_rng(5), (CameraNoise(), CameraNoise())
    for both in sensors:
        found = find_spots(pair_of(both, rng), detector, windows, np.zeros(2), noise)
        noise = found.noise
        yield found


def variance(noise: Noise | None) -> float:
    assert noise is not None
    return noise.read**2 + noise.gain * (SIGNAL - noise.black)


def true_variance(sensor: Sensor) -> float:
    return sensor.read**2 + sensor.gain * SIGNAL + 1 / 12


def test_several_pictures_show_the_noise_better_than_one() -> None:
    sensor, single, kept = Sensor(), [], []
    for seed in range(12):
        rng, noise = np.random.default_rng(seed), (CameraNoise(), CameraNoise())
        for _ in range(FIRST_PICTURES):
            pair = pair_of((sensor, sensor), rng)
            found = find_spots(pair, detect_in_turn, WINDOWS, np.zeros(2), noise)
            noise = found.noise
            single += [variance(spots.noise) for spots in found.spots]
        kept += [variance(one.known) for one in noise]
    single_off, kept_off = (
        np.sqrt(np.mean(np.square(np.array(some) / true_variance(sensor) - 1)))
        for some in (single, kept)
    )
    assert kept_off < 0.7 * single_off  # white noise alone would make it half
    assert kept_off < 0.1


def test_noise_is_estimated_on_the_first_pictures_and_then_on_one_in_many() -> None:
    detector, count = Counter(), FIRST_PICTURES + 2 * ESTIMATE_EVERY
    *_, last = found_in_turn([(QUIET, NOISY)] * count, detector)
    own = [n for n, (left, _) in enumerate(detector.given) if left is None]
    first, later = own[:FIRST_PICTURES], own[FIRST_PICTURES:]
    assert first == list(range(FIRST_PICTURES))
    assert 2 <= len(later) <= 4  # a picture whose spots misfit by chance adds to them
    for noise, sensor in zip(last.noise, (QUIET, NOISY), strict=True):
        assert variance(noise.mean) == pytest.approx(true_variance(sensor), rel=0.15)


@pytest.mark.parametrize(("before", "after"), [(QUIET, NOISY), (NOISY, QUIET)])
def test_a_camera_that_changes_its_gain_is_measured_with_its_new_noise_at_once(
    before: Sensor, after: Sensor
) -> None:
    """The left camera changes, the right one does not, and keeps what is known of it."""
    sensors = [(before, before)] * (FIRST_PICTURES + 2) + [(after, before)]
    *_, known, changed = found_in_turn(sensors, Counter())
    left, right = changed.spots
    assert variance(left.noise) == pytest.approx(true_variance(after), rel=0.35)
    assert right.noise == known.noise[1].mean
    alone = detect_in_turn(pair_of(sensors[-1], np.random.default_rng(8)), WINDOWS)[0]
    np.testing.assert_allclose(left.covariance, alone.covariance, rtol=0.5, atol=1e-4)


def test_a_noise_that_changes_by_less_than_a_picture_shows_is_followed() -> None:
    louder = Sensor(read=NOISY.read * 1.4**0.5, gain=NOISY.gain * 1.4)
    count = FIRST_PICTURES + ESTIMATE_EVERY
    sensors = [(NOISY, NOISY)] * count + [(louder, NOISY)] * (ESTIMATE_EVERY + FIRST_PICTURES)
    found = list(found_in_turn(sensors, Counter()))
    before, (left, right) = found[count - 1].noise[0], found[-1].noise
    assert variance(before.mean) == pytest.approx(true_variance(NOISY), rel=0.15)
    assert variance(left.mean) == pytest.approx(true_variance(louder), rel=0.15)
    assert variance(right.mean) == pytest.approx(true_variance(NOISY), rel=0.15)


def test_a_whole_frame_estimates_its_own_noise() -> None:
    detector = Counter()
    sensors = [(QUIET, QUIET)] * (FIRST_PICTURES + 2)
    *_, last = found_in_turn(sensors, detector, EVERYWHERE)
    assert all(given == (None, None) for given in detector.given)
    assert last.whole_frame
    assert last.noise[0].known is not None


def test_pictures_without_a_clean_spot_tell_no_noise() -> None:
    black = np.zeros((360, 640), dtype=np.uint8)
    pair = StereoPair(0, 0.0, 0.0, 0.0, 0.0, black, black)
    found = find_spots(pair, detect_in_turn, WINDOWS, np.zeros(2), (CameraNoise(), CameraNoise()))
    assert found.noise == (CameraNoise(), CameraNoise())
