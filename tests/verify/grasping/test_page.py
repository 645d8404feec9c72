"""The page of a grab: what it orders, what it cannot, and that a stop always gets through."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.client import connect

from tests.support.grasp.page import STANDS, Cell, grabbing
from verify.grasping.control.states import MOVING_STATES, GraspEvent, GraspState
from verify.simulation.cell.scene import Cap, CellScene

WANDERS = CellScene((Cap("blue", (0.40, -0.20), (0.0, 0.04), 30.0),), seed=2)


def following(cell: Cell) -> None:
    cell.until(lambda: cell.state is GraspState.FOLLOWING)


def latest(line: Any, wanted: Any) -> dict[str, Any]:
    """The next row for which something holds."""
    end = time.monotonic() + 20.0
    while time.monotonic() < end:
        message = line.recv(timeout=20)
        if isinstance(message, bytes):
            continue
        output = json.loads(message)
        if output["type"] == "rows" and wanted(output["rows"][-1]):
            row: dict[str, Any] = output["rows"][-1]
            return row
    raise AssertionError("no such row came")


def test_a_stop_holds_as_the_key_does_and_it_stays_held() -> None:
    with grabbing(WANDERS) as cell, cell.line() as line:
        following(cell)
        assert cell.travelled(30) > np.deg2rad(0.5)
        line.send("hold")
        cell.until(lambda: cell.state is GraspState.HOLDING_OPERATOR)
        passage = cell.grab.loop.machine.log[-1]
        assert (passage.source, passage.event) == (GraspState.FOLLOWING, GraspEvent.HOLD)
        cell.turns(20)
        assert cell.travelled(30) < 1e-6
        line.send("grab 3")
        line.send(f"grab {len(cell.states)}")
        cell.turns(10)
        assert cell.state is GraspState.HOLDING_OPERATOR


@pytest.mark.realtime
def test_a_stop_gets_through_while_pictures_are_stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    with grabbing(WANDERS) as cell, cell.line() as line:
        following(cell)
        stuck, asked = threading.Event(), threading.Event()

        def pictures() -> tuple[()]:
            asked.set()
            stuck.wait(20.0)
            return ()

        monkeypatch.setattr(cell.page._source, "pictures", pictures)
        assert asked.wait(20.0)
        began = time.monotonic()
        line.send("hold")
        cell.until(lambda: cell.state is GraspState.HOLDING_OPERATOR)
        assert time.monotonic() - began < 5.0
        stuck.set()
        latest(line, lambda row: row["stops"] == 1)


@pytest.mark.realtime
def test_a_stop_gets_through_from_a_viewer_whose_line_is_full(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with grabbing(WANDERS) as cell:
        following(cell)
        large, given = bytes(4 << 20), threading.Semaphore(0)

        def pictures() -> list[tuple[int, dict[str, Any], bytes]]:
            given.release()
            return [(0, {}, large)]

        monkeypatch.setattr(cell.page._source, "pictures", pictures)
        with cell.line(max_queue=1, close_timeout=0.1) as asleep:  # reads nothing
            for _ in range(5):
                assert given.acquire(timeout=20.0)
            began = time.monotonic()
            asleep.send("hold")
            cell.until(lambda: cell.state is GraspState.HOLDING_OPERATOR)
            assert time.monotonic() - began < 5.0


@pytest.mark.realtime
def test_the_grab_counts_where_the_key_does_and_lifts() -> None:
    with grabbing(paced=False) as cell, cell.line() as line:
        line.send("grab 0")  # the state is another by then, or it is no order in it
        row = latest(line, lambda row: row["grab_lacks"] == "")
        assert cell.state is GraspState.FOLLOWING
        line.send(f"grab {row['passages'] - 1}")  # what was seen is past
        refused = latest(line, lambda row: "look again" in row["answer"])
        assert refused["state"] == "following"
        line.send(f"grab {row['passages']}")
        cell.until(lambda: cell.state is GraspState.LIFTED)
        held = cell.grab.world.held
        assert held[0] == 0
        ended = latest(line, lambda row: row["finished"])
        assert ended["finished"] == "lifted: the object came along; the controls were given back"


@pytest.mark.realtime
def test_without_execute_the_page_moves_nothing() -> None:
    with grabbing(execute=False, selects=True) as cell, cell.line() as line:
        cell.until(lambda: cell.state is GraspState.SEARCHING)
        row = latest(line, lambda row: row["state"] == "searching")
        assert row["reason"] == "no object is selected"
        home = cell.grab.world.arm.q(0.0)
        words = ["grab 0", "grab 1", "execute", "resume", "follow ordered", "retreat", "start"]
        for word in (*words, "select left {},{},{},{}".format(*cell.box())):
            line.send(word)
        row = latest(line, lambda row: row["position_mm"] is not None)
        assert "selected" not in row["reason"]
        assert row["grab_lacks"] in (None, "")
        for count in range(8):
            line.send(f"grab {count}")
        cell.turns(20)
        assert not MOVING_STATES & set(cell.states)
        assert np.array_equal(cell.grab.world.arm.q(cell.grab.world.t), home)


BAD = [
    "", " ", "hold ", "HOLD", "hold hold", "grab", "grab ", "grab -1", "grab 1.0", "grab NaN",
    "grab true", "grab ٣", "grab " + "9" * 3000, "grab null", '{"order": "grab"}', "resume", "r",
    "select", "select left", "select up 1,2,30,40", "select left 1,2,30", "select left a,b,c,d",
    "select left NaN,NaN,30,30", "select left inf,0,30,30", "select left 1.5,2,30,30",
    "select left -5,-5,30,30", "select left 0,0,0,0", "select left 5,5,4,4",
    "select left 0,0,9999999999,9999999999", "select right 630,350,40,40",
    "select left 10,10,60,40", "select left " + "1," * 1500, "select left [1,2,30,40]", "\x00",
]  # fmt: skip


@pytest.mark.realtime
def test_bad_messages_are_refused_and_change_nothing() -> None:
    with grabbing(selects=True) as cell, cell.line() as line:
        cell.until(lambda: cell.state is GraspState.SEARCHING)
        for text in BAD:
            line.send(text)
            cell.turns(2)
        assert cell.states == [GraspState.SEARCHING]
        assert cell.grab.loop.aim.target is None
        row = latest(line, lambda row: row["answers"] >= 12)
        assert row["stops"] == 0
        line.send("select left 20,20,40,40")  # a refusal is shown
        latest(line, lambda row: "no colour that its surroundings do not have" in row["answer"])
        cell.turns(3)
        assert cell.page._requests.stops == 0
        assert cell.state is GraspState.SEARCHING
        line.send("select left {},{},{},{}".format(*cell.box()))  # and a good one counts
        latest(line, lambda row: row["status"] == "tracked")


@pytest.mark.realtime
def test_another_object_may_be_selected_while_it_is_held_and_then_that_is_gone_after() -> None:
    with grabbing(STANDS) as cell, cell.line() as line:
        following(cell)
        line.send("hold")
        cell.until(lambda: cell.state is GraspState.HOLDING_OPERATOR)
        latest(line, lambda row: row["state"] == "holding-operator" and row["may_choose"])
        line.send("select right {},{},{},{}".format(*cell.box(cap=1, side=1)))
        row = latest(line, lambda row: row["answer"].startswith("object selected on the page"))
        row = latest(line, lambda row: row["status"] == "tracked")
        assert row["state"] == "holding-operator"
        np.testing.assert_allclose(row["position_mm"], 1e3 * cell.place(1), atol=3.0)


@pytest.mark.realtime
def test_the_command_serves_it_and_names_in_the_report_what_was_selected(tmp_path: Path) -> None:
    words = ["--json", "grab", "--sim", "--small", "--page", "--page-port", "0", "--for", "40s"]
    with subprocess.Popen(
        [sys.executable, "-m", "verify", *words, "-o", str(tmp_path / "out")],
        stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ) as command:  # fmt: skip
        url = json.loads(command.stdout.readline())["url"]
        host = url.removeprefix("http://").rstrip("/")
        with connect(f"ws://{host}/live", origin=f"http://{host}", max_queue=None) as line:
            latest(line, lambda row: row["state"] == "searching")
            line.send("select left 600,300,60,90")
            latest(line, lambda row: row["answer"].startswith("selection left 600,300,60,90"))
        command.send_signal(signal.SIGINT)
        said = [json.loads(row) for row in command.stdout.read().splitlines()]
    assert command.returncode == 130
    assert said[-1]["summary"]["target"] == "object selected on the page"
    assert re.search("Searching|searching", (tmp_path / "out" / "report.html").read_text())
