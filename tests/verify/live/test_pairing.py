import numpy as np
import pytest

from verify.devices.protocols import CameraFrame
from verify.live.pairing import (
    MAX_WAITING,
    NO_PARTNER,
    NOT_LATER,
    OTHER_CAMERA_STALLED,
    FramePair,
    Pairing,
)

DARK = np.zeros((2, 2), dtype=np.uint8)
PERIOD = 1 / 30


def frame(t: float) -> CameraFrame:
    return CameraFrame(t, 0.0, DARK, None, 0)


def play(pairing: Pairing, events: list[tuple[float, int]]) -> list[FramePair]:
    """Give pictures in the order in which they were taken."""
    made = [pairing.add(side, frame(t), t) for t, side in sorted(events)]
    return [pair for pair in made if pair is not None]


@pytest.mark.parametrize("phase", [-0.4, -0.1, 0.0, 0.2, 0.5])
def test_free_running_cameras_lose_no_picture_whatever_their_phase(phase: float) -> None:
    pairing = Pairing()
    times = 1.0 + PERIOD * np.arange(100)
    chance = np.random.default_rng(0)
    left = [(t, 0) for t in times + chance.normal(0, 0.001, 100)]
    right = [(t, 1) for t in times + phase * PERIOD + chance.normal(0, 0.001, 100)]
    pairs = play(pairing, left + right)
    assert len(pairs) >= 99  # the first or last may have its partner outside
    skew = np.array([pair.right.t - pair.left.t for pair in pairs])
    assert np.all(np.abs(skew) <= 0.6 * PERIOD)
    for side in ("left", "right"):
        assert np.all(np.diff([getattr(pair, side).t for pair in pairs]) > 0)


def test_a_slower_camera_leaves_the_other_one_s_pictures_without_partner() -> None:
    pairing = Pairing()
    events = [(k / 60, 0) for k in range(120)] + [(k / 30 + 0.001, 1) for k in range(60)]
    pairs = play(pairing, events)
    assert len(pairs) == pytest.approx(60, abs=2)
    skews = np.abs([pair.right.t - pair.left.t for pair in pairs])
    assert np.median(skews) < 1 / 60
    assert pairing.dropped[NO_PARTNER] >= 55


def test_a_stalled_camera_costs_pairs_that_are_counted_and_no_memory() -> None:
    pairing = Pairing(PERIOD)
    for k in range(300):
        assert pairing.add(0, frame(k * PERIOD), 0.0) is None
    assert pairing.dropped[OTHER_CAMERA_STALLED] == 300 - MAX_WAITING
    after = play(pairing, [(10 + k * PERIOD, side) for k in range(5) for side in (0, 1)])
    assert len(after) == 5
    assert pairing.dropped[OTHER_CAMERA_STALLED] + pairing.dropped[NO_PARTNER] == 300


def test_a_picture_that_is_not_later_than_the_last_is_refused() -> None:
    pairing = Pairing(PERIOD)
    play(pairing, [(1.0, 0), (1.0, 1)])
    assert pairing.add(0, frame(0.9), 0.0) is None
    assert pairing.dropped == {NOT_LATER: 1}


def test_pictures_further_apart_than_the_tolerance_are_no_pair() -> None:
    pairing = Pairing(PERIOD)
    assert play(pairing, [(1.0, 0), (1.0 + 0.61 * PERIOD, 1)]) == []
