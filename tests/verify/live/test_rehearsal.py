"""A rehearsal is over when the next occasion comes, and never makes it wait twice."""

import pytest

from verify.live.rehearsal import FEWEST, MARGIN, Rehearsal

INTERVAL = 1 / 30  # s


class Hand:
    """A clock that stands still until it is moved, and work that takes some of its time."""

    def __init__(self, takes: float) -> None:
        self.t, self.takes, self.done = 100.0, takes, 0

    def now(self) -> float:
        return self.t

    def work(self) -> None:
        self.t += self.takes
        self.done += 1


def noted(rehearsal: Rehearsal, hand: Hand, occasions: int) -> None:
    for _ in range(occasions):
        hand.t += INTERVAL
        rehearsal.note()


def test_it_ends_before_the_next_occasion_by_what_it_took_last() -> None:
    hand = Hand(takes=0.006)
    rehearsal = Rehearsal(hand.work, hand.now)
    assert rehearsal.patience() is None
    noted(rehearsal, hand, FEWEST - 1)
    assert rehearsal.patience() is None  # how often it happens is not known yet
    noted(rehearsal, hand, 1)
    assert rehearsal.patience() == pytest.approx(INTERVAL - MARGIN)
    rehearsal.run()
    assert hand.done == 1
    assert rehearsal.patience() is None  # once before each occasion
    hand.t += INTERVAL - hand.takes
    rehearsal.note()
    assert rehearsal.patience() == pytest.approx(INTERVAL - MARGIN - hand.takes)
    hand.t += INTERVAL  # the occasion is late: at once, not in the past
    assert rehearsal.patience() == 0.0


def test_without_room_for_it_there_is_none_until_there_is_again() -> None:
    hand = Hand(takes=0.02)  # of 33 ms
    rehearsal = Rehearsal(hand.work, hand.now)
    noted(rehearsal, hand, FEWEST)
    rehearsal.run()
    hand.t += INTERVAL - hand.takes
    rehearsal.note()
    assert rehearsal.patience() is None
    noted(rehearsal, hand, 1)
    assert rehearsal.patience() is not None  # it is tried once more
