import msgspec
import numpy as np
import pytest

from tests.support.simulated import InMemory, in_memory, sample
from verify.calibration.registration.led_tracks import (
    PairSpots,
    drop_still_spots,
    find_leds,
    find_spots,
)
from verify.core.records import Array
from verify.errors import InputError
from verify.simulation.scenario import Distractor, Mirror

PAIRS = 14


@pytest.fixture(scope="module")
def session() -> InMemory:
    """A healthy arm before a mirror that shows every LED again, with two lamps beside it."""
    plain = in_memory(msgspec.structs.replace(sample(pairs=PAIRS), fault=[]))
    middle = plain.simulated.world.led_points(plain.frames.t_left).reshape(-1, 3).mean(axis=0)
    x, y, z = (middle * 1e3).tolist()
    return in_memory(
        msgspec.structs.replace(
            sample(pairs=PAIRS, rate_hz=5.0),
            fault=[],
            distractor=[
                Distractor(position_mm=(x - 110, y + 60, z + 50)),
                Distractor(position_mm=(x + 120, y - 70, z + 20)),
            ],
            mirror=[Mirror(point_mm=(x, y, z + 150), normal=(0.3, 0.0, -1.0), reflectance=0.5)],
        )
    )


@pytest.fixture(scope="module")
def looks(session: InMemory) -> list[PairSpots]:
    return find_spots(session, lambda _done, _total: None)


def sides(leds: Array) -> Array:
    apart = np.linalg.norm(leds[:, None] - leds, axis=2)
    return np.sort(apart[np.triu_indices(len(leds), 1)])


def test_lamps_that_stand_still_are_left_out(looks: list[PairSpots]) -> None:
    moving = drop_still_spots(looks)
    fewer = [len(a.spots[0]) - len(b.spots[0]) for a, b in zip(looks, moving, strict=True)]
    assert np.median(fewer) == 2


def test_the_leds_are_the_body_that_moves_whatever_shines_beside_them(
    session: InMemory, looks: list[PairSpots]
) -> None:
    found = find_leds(drop_still_spots(looks), session.rig, None, "here")
    # the cameras fire 4 ms apart, which a first look does not allow for
    np.testing.assert_allclose(sides(found), sides(session.marker.leds), atol=2e-3)


def test_another_number_of_leds_is_refused(session: InMemory, looks: list[PairSpots]) -> None:
    with pytest.raises(InputError, match="4 LEDs move together; 5 are asked for"):
        find_leds(drop_still_spots(looks), session.rig, 5, "here")


def test_pictures_without_leds_are_refused(session: InMemory, looks: list[PairSpots]) -> None:
    still = drop_still_spots([looks[0]] * 8)  # eight times the same picture
    with pytest.raises(InputError, match="no three bright points move together"):
        find_leds(still, session.rig, None, "here")
