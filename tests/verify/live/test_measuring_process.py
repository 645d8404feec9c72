"""A measurement in a process of its own gives what one here gives, and its loss costs no pair."""

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.support.simulated import rendered
from verify.core.processes import ChildProcess, SharedPicture, location_of, picture_at
from verify.core.records import Array, Measurement, StereoPair
from verify.live.measuring_process import MeasuringProcess
from verify.measurement.chain import Setup, measure
from verify.simulation import library
from verify.simulation.session.simulate import SimulatedSession, simulate_session

PAIRS = 8
LOST_AFTER = 4


@pytest.fixture(scope="module")
def session() -> SimulatedSession:
    return simulate_session(library.load("multi_joint_rv_3sd"))


@pytest.fixture(scope="module")
def here(session: SimulatedSession) -> list[Measurement]:
    return list(measure(pairs(session), Setup(session.rig, session.marker), causal=True))


def pairs(session: SimulatedSession) -> Iterator[StereoPair]:
    return islice(rendered(session), PAIRS)


def nothing(_t: float) -> list[Array]:
    return []


def alike(found: list[Measurement], wanted: list[Measurement]) -> None:
    assert [(m.frame, m.settled) for m in found] == [(m.frame, m.settled) for m in wanted]
    for one, other in zip(found, wanted, strict=True):
        assert (one.status, one.t, one.choice) == (other.status, other.t, other.choice)
        np.testing.assert_array_equal(one.pose.rig_T_flange, other.pose.rig_T_flange)
        np.testing.assert_array_equal(one.pose.covariance, other.pose.covariance)


def test_it_gives_the_same_figures_and_ends(
    session: SimulatedSession, here: list[Measurement]
) -> None:
    message: list[str] = []
    with closing(MeasuringProcess(session.rig, session.marker, message.append)) as process:
        alike(list(process.measure(pairs(session), nothing)), here)
    assert not message
    assert not process._process._process.is_alive()


@pytest.mark.realtime
def test_ctrl_c_while_it_loads_ends_it(
    session: SimulatedSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ChildProcess, "wait_until_ready", interrupted)
    with pytest.raises(KeyboardInterrupt):
        MeasuringProcess(session.rig, session.marker, [].append)
    for child in multiprocessing.active_children():
        child.join(60.0)
        assert child.exitcode == -signal.SIGTERM


def test_memory_that_a_killed_process_group_has_left_is_removed() -> None:
    script = "from verify.core.processes import SharedPicture as P; print(*P().room((9,))); input()"
    killed = subprocess.Popen(
        [sys.executable, "-uc", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert killed.stdout is not None
    left = Path("/dev/shm", killed.stdout.readline().split()[0])
    with closing(SharedPicture()) as alive, closing(SharedPicture()) as later:
        mine = alive.room((9,))
        assert left.exists()  # its process is running
        os.killpg(killed.pid, signal.SIGKILL)
        killed.communicate()
        later.room((9,))
        assert not left.exists()
        assert picture_at(*mine).shape == (9,)


@pytest.mark.realtime
def test_a_lost_process_costs_no_pair_and_is_reported(
    session: SimulatedSession, here: list[Measurement]
) -> None:
    message: list[str] = []

    def given(process: MeasuringProcess) -> Iterator[StereoPair]:
        for pair in pairs(session):
            if pair.frame == LOST_AFTER:
                process._process._process.kill()
                process._process._process.join()
            yield pair

    with closing(MeasuringProcess(session.rig, session.marker, message.append)) as process:
        found = list(process.measure(given(process), nothing))
    assert [m.frame for m in found if not m.settled] == list(range(PAIRS))
    # the last pair before the loss has no successor to settle it
    settled = [m.frame for m in found if m.settled]
    assert settled == [*range(LOST_AFTER - 1), *range(LOST_AFTER, PAIRS)]
    assert all(m.status == "measured" for m in found)
    before = 2 * LOST_AFTER - 1
    alike(found[:before], here[:before])
    assert len(message) == 1
    assert "measured by the main process from now on" in message[0]


def test_a_picture_that_is_shared_already_is_not_put_anywhere_again() -> None:
    shared, image = SharedPicture(), np.arange(12, dtype=np.uint8).reshape(3, 4)
    try:
        place = shared.put(image)
        there = picture_at(*place)
        np.testing.assert_array_equal(there, image)
        assert location_of(there) == place
        assert location_of(there.copy()) is None
        assert location_of(there[:2]) == (place[0], (2, 4))
        assert location_of(there[1:]) is None
        assert location_of(there[:, :2]) is None
        assert location_of(np.zeros((5000, 5000), dtype=np.uint8)) is None
    finally:
        shared.close()


@pytest.mark.realtime
def test_a_prepared_pair_is_the_one_that_is_measured(
    session: SimulatedSession, here: list[Measurement]
) -> None:
    def prepared(process: MeasuringProcess) -> Iterator[StereoPair]:
        for pair in pairs(session):
            process.prepare(next(rendered(session)))  # of which nothing came
            process.prepare(pair)
            yield pair

    with closing(MeasuringProcess(session.rig, session.marker, [].append)) as process:
        alike(list(process.measure(prepared(process), nothing)), here)
