"""A session measured in parts gives the results of one pass, to the last bit."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from reports import Results
from tests.end_to_end.command import SAMPLES
from verify.analysis import analyse
from verify.batch import parts
from verify.batch.parts import Part, Span, joined, measure_part, measured_session, pairs_of, spans
from verify.session import Session, open_session

NAMES = ("multi_joint_fault_6r", "quarter_circle_6r")


@pytest.fixture(scope="module", params=NAMES)
def session(request: pytest.FixtureRequest) -> Session:
    return open_session(SAMPLES / request.param)


@pytest.fixture(scope="module")
def plain(session: Session) -> Results:
    return analyse(session)


def in_parts(session: Session, length: int, early: int, patch: pytest.MonkeyPatch) -> list[Part]:
    patch.setattr(parts, "PART", length)
    patch.setattr(parts, "EARLY", early)
    sent = pickle.loads(pickle.dumps(session))
    return [measure_part(sent, span) for span in spans(len(session))]


def assert_same(session: Session, plain: Results, made: list[Part]) -> None:
    whole = measured_session(session, *joined(session, pickle.loads(pickle.dumps(made))))
    again = analyse(whole, chain=whole.chain)
    assert again.summary == plain.summary
    assert again.setup == plain.setup
    assert again.images == plain.images
    assert set(again.tables) == set(plain.tables)
    for name, table in plain.tables.items():
        assert again.tables[name].equals(table), name


@pytest.mark.parametrize("early", [0, 12], ids=["parts that begin cold", "parts that begin early"])
def test_parts_give_the_same_bits_as_one_pass(
    session: Session, plain: Results, early: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = in_parts(session, 13, early, monkeypatch)
    assert len(made) > 2
    assert_same(session, plain, made)


@pytest.mark.parametrize("session", NAMES[1:], indirect=True)
def test_a_part_that_carries_something_else_is_measured_again(
    session: Session, plain: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = in_parts(session, 20, 4, monkeypatch)
    wrong = dict.fromkeys(made[1].carried, b"something else")
    lies = {number: [] for number in made[1].outcomes}
    made[1] = replace(made[1], carried=wrong, outcomes=lies, shown=None)
    assert_same(session, plain, made)


def test_an_early_start_soon_carries_what_the_chain_from_the_beginning_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    early = parts.EARLY
    session = open_session(SAMPLES / "quarter_circle_6r")
    monkeypatch.setattr(parts, "EARLY", 0)
    true = measure_part(session, Span(0, len(session)))
    start = 10
    late = measure_part(session, Span(start, len(session)))  # begins with nothing carried
    met = start + early
    assert late.carried[met] == true.carried[met]


def test_the_pairs_of_a_span_are_those_of_the_session() -> None:
    session = open_session(SAMPLES / "quarter_circle_6r")
    every = list(session.pairs())
    with pairs_of(session, Span(7, 12)) as some:
        for pair, whole in zip(some, every[7:12], strict=True):
            assert (pair.frame, pair.t_left, pair.pan_right) == (
                whole.frame, whole.t_left, whole.pan_right,
            )  # fmt: skip
            assert np.array_equal(pair.left, whole.left)
            assert np.array_equal(pair.right, whole.right)


def test_a_short_session_stays_whole_and_a_long_one_is_covered_once() -> None:
    assert spans(parts.PART) == [Span(0, parts.PART)]
    many = spans(10 * parts.PART + 7)
    assert len(many) == 10
    covered = [n for span in many for n in range(span.first, span.last)]
    assert covered == list(range(10 * parts.PART + 7))
