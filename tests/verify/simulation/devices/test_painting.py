"""Pictures painted in another process are those painted here, and its loss costs none."""

import os
import signal
import time

import numpy as np
import pytest

from verify.core.processes import ChildProcess
from verify.simulation import library
from verify.simulation.devices.painting import (
    LATE_NOTE,
    RemotePainter,
    RenderRequest,
    build_painter,
)
from verify.simulation.session.simulate import START_OFFSET, simulate_session

pytestmark = pytest.mark.realtime

SCENARIO = "multi_joint_rv_3sd"
LIMIT = 60.0  # s for the other process's start, on a busy machine
SIGHTS = [
    RenderRequest(side, START_OFFSET + 0.3 * number, 0.01 * side, lit, hidden, number)
    for number in range(3)
    for side, lit, hidden in ((0, False, {}), (1, True, {0: 1.0}))
]


def ready(distant: RemotePainter) -> ChildProcess[object, None]:
    process, end = distant._process, time.monotonic() + LIMIT
    while not process.is_ready():
        assert time.monotonic() < end
        time.sleep(0.05)
    return process


def test_both_processes_paint_the_same_and_one_replaces_the_other() -> None:
    near = build_painter(simulate_session(library.load(SCENARIO)))
    wanted = [near.paint(sight) for sight in SIGHTS]
    assert not np.array_equal(wanted[0], wanted[1])
    distant = RemotePainter(SCENARIO, near, LIMIT)
    assert all(map(np.array_equal, map(distant.paint, SIGHTS), wanted))  # while it starts
    process = ready(distant)
    assert all(map(np.array_equal, map(distant.paint, SIGHTS), wanted))
    assert distant._process is process  # it was asked, and answered
    assert not distant.trouble
    process._process.kill()
    assert all(map(np.array_equal, map(distant.paint, SIGHTS), wanted))
    assert distant._process is None
    assert "painted by the main process from now on" in distant.trouble
    distant.close()
    distant.close()


def test_a_late_process_is_skipped_until_it_answers() -> None:
    near = build_painter(simulate_session(library.load(SCENARIO)))
    wanted = [near.paint(sight) for sight in SIGHTS]
    distant = RemotePainter(SCENARIO, near, 0.01)
    process = ready(distant)
    os.kill(process._process.pid, signal.SIGSTOP)
    assert all(map(np.array_equal, map(distant.paint, SIGHTS), wanted))
    assert distant.trouble == LATE_NOTE
    os.kill(process._process.pid, signal.SIGCONT)
    distant._timeout, end = LIMIT, time.monotonic() + LIMIT
    while distant.trouble:
        assert np.array_equal(distant.paint(SIGHTS[1]), wanted[1])
        assert time.monotonic() < end
    assert distant._process is process
    assert all(map(np.array_equal, map(distant.paint, SIGHTS), wanted))
    distant.close()
    distant.close()


def test_a_process_that_fails_to_start_is_reported_and_replaced() -> None:
    near = build_painter(simulate_session(library.load(SCENARIO)))
    distant, end = RemotePainter("no such scenario", near), time.monotonic() + LIMIT
    while not distant.trouble:
        assert np.array_equal(distant.paint(SIGHTS[0]), near.paint(SIGHTS[0]))
        assert time.monotonic() < end
        time.sleep(0.05)
    assert "InputError" in distant.trouble
    assert "no such scenario" in distant.trouble
