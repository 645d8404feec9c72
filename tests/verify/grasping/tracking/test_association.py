"""Association: targets are not confused where another explains the measurement."""

import numpy as np
import pytest

from verify.grasping.tracking.association import (
    ObjectTrack,
    TargetDecision,
    TargetIdentity,
    associate,
)
from verify.grasping.tracking.camshift import Blob
from verify.grasping.tracking.kalman import begin_track
from verify.grasping.tracking.pairing import StereoObject
from verify.grasping.tracking.stereo import StereoPoint
from verify.grasping.tracking.target import TrackingOptions

RATE, AREA = 30.0, 1.2e-3  # Hz, m²
HERE, THERE = (0.0, 0.0, 0.7), (0.12, 0.0, 0.7)
DENSITY = 0.1
SQUARE = np.eye(2)
BLOB = Blob(
    np.zeros(2), SQUARE, SQUARE, np.ones(2), 1.0, 1.0, (0, 0, 1, 1), 1.0, 1.0, 1.0, False, False
)  # fmt: skip


def seen(*place: float, area: float = AREA, reach: float | None = None) -> StereoObject:
    noise = np.eye(3) * 0.0005**2
    point = StereoPoint(np.array(place), noise, noise, 0.0, np.full(2, place[2]))
    areas, reach = np.full(2, area), area if reach is None else reach
    size = np.full(2, 0.04)
    return StereoObject(BLOB, BLOB, point, areas, reach, size, np.full(2, 1e-3))


class Film:
    """Steps an identity at 30 Hz."""

    def __init__(self) -> None:
        self.identity, self.frame = TargetIdentity(TrackingOptions(), DENSITY), 0

    def show(self, *candidates: StereoObject, times: int = 1) -> TargetDecision:
        for _ in range(times):
            self.frame += 1
            verdict = self.identity.step(self.frame / RATE, list(candidates))
        return verdict

    def statuses(self, candidate: StereoObject, times: int) -> list[str]:
        return [self.show(candidate).status for _ in range(times)]

    def target(self) -> ObjectTrack:
        assert self.identity.target is not None
        return self.identity.target


def watched(*others: StereoObject) -> Film:
    """A target that was selected, and has been in view for a second."""
    film = Film()
    film.identity.choose(0.0, seen(*HERE))
    film.show(seen(*HERE), *others, times=30)
    return film


@pytest.mark.parametrize(
    ("hidden", "place"), [(60, HERE), (900, (0.4, 0.1, 0.9))], ids=["in place", "anywhere, later"]
)
def test_a_hidden_target_is_lost_and_found_again(
    hidden: int, place: tuple[float, float, float]
) -> None:
    film = watched()
    assert film.show(times=hidden).status == "lost"
    assert film.statuses(seen(*place), 3) == ["lost", "lost", "tracked"]


def test_another_known_object_is_not_taken_for_a_lost_target() -> None:
    film = watched(seen(*THERE))
    verdict = film.show(seen(*THERE), times=90)
    assert (verdict.status, verdict.chosen) == ("lost", None)
    assert verdict.reason == "only another of its colour is seen"
    elsewhere = seen(-0.2, 0.0, 0.7)  # it comes back while the other stays
    verdict = film.show(seen(*THERE), elsewhere, times=5)
    assert (verdict.status, verdict.chosen) == ("tracked", elsewhere)


def test_two_returning_targets_stay_ambiguous() -> None:
    film = watched(seen(0.03, 0.0, 0.7))
    film.show(times=150)  # five seconds in which they may have changed places
    verdict = film.show(seen(0.015, 0.02, 0.7), seen(0.015, -0.02, 0.7), times=10)
    assert verdict.status == "occluded"
    assert verdict.reason == "it cannot be distinguished from another of its colour"


def test_a_merged_patch_moves_nothing() -> None:
    film = watched()
    assert film.show(seen(0.01, 0.0, 0.7, reach=2 * AREA)).status == "occluded"
    assert abs(film.target().track.position[0]) < 1e-9


def test_a_part_in_view_is_occluded_and_its_size_is_not_learned() -> None:
    film = watched()
    verdict = film.show(seen(*HERE, area=0.6 * AREA), times=60)
    assert (verdict.status, verdict.reason) == ("occluded", "a part of it is hidden")
    assert film.target().area == pytest.approx(AREA)


def test_a_jump_is_accepted_after_a_few_pairs_only() -> None:
    film = watched()
    assert film.show(seen(0.05, 0.0, 0.7)).status == "lost"
    assert film.show(seen(*HERE)).status == "tracked"  # it was nothing
    assert film.show(seen(0.05, 0.0, 0.7), times=3).status == "tracked"


def test_the_best_assignment_is_made_for_all_at_once() -> None:
    def known(x: float) -> ObjectTrack:
        track = begin_track(0.0, np.array([x, 0.0, 0.7]), np.eye(3) * 0.01**2, 0.01)
        return ObjectTrack(track, AREA, np.full(2, 0.04), 0.0, 5)

    # the nearest to both is the candidate between them; only one may have it
    who = associate(
        [known(0.0), known(0.05)], [seen(0.03, 0, 0.7), seen(0.06, 0, 0.7)], 0.0, DENSITY
    )
    assert who.choice == (0, 1)
    alone = associate([known(0.0)], [seen(0.001, 0.0, 0.7)], 0.0, DENSITY)
    assert alone.sure(0)
    between = associate([known(0.0), known(0.05)], [seen(0.025, 0.0, 0.7)], 0.0, DENSITY)
    assert not between.sure(0)
    assert not between.sure(1)
