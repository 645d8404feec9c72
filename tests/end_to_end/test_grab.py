"""`verify grab --sim` as a user runs it: exit status, what is left behind, what is said."""

import json
import math
import os
import re
import time
from pathlib import Path

import av
import pytest
import typer
from typer.testing import CliRunner

from reports.results import read
from verify.commands.grab import grab
from verify.commands.grabbing import Keys
from verify.errors import InputError
from verify.grab.states import Event
from verify.session import open_session
from verify.sim.cell import World
from verify.sim.cell_scene import drawn_scene
from verify.sim.cell_setup import SMALL, cell_setup
from verify.terminal import terminal

APP = typer.Typer()
APP.command()(grab)
APP.command(name="other")(lambda: None)  # with two commands a name is needed, as in `verify`


def verify_grab(*words: str) -> tuple[int, str]:
    found = CliRunner().invoke(APP, ["grab", *words], standalone_mode=False)
    if found.exception is not None:
        raise found.exception
    return found.return_value, found.output


def test_a_grab_leaves_a_film_a_session_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--seed", "4", "-o", str(out))
    status, said = verify_grab(*words)
    assert status == 0
    assert "lifted: the object came along" in said
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["state"], summary["released"]) == ("lifted", True)
    session = open_session(out / "session")
    assert session.warnings == ()
    with av.open(str(out / "grab.mp4")) as film:
        assert film.streams.video[0].frames == len(session) == summary["cycles"]
    page = (out / "report.html").read_text()
    for word in ("Grasped and lifted", "States over time", "CAMSHIFT", "Joint angles", "Margins"):
        assert word in page
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")
    results = read(out / "results")
    assert len(results.table("cycles")) == summary["cycles"]
    assert results.table("passages")["to_state"].iloc[-1] == "released"


def test_without_execute_the_plan_is_told_and_nothing_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(terminal, "as_json", True)
    pair = World(cell_setup(SMALL), drawn_scene(4)).pair()
    assert pair is not None
    picture = pair.left.astype(int)
    rows, columns = ((picture[..., 0] - picture[..., 2]) > 60).nonzero()  # the blue cap
    x, y = columns.min() - 2, rows.min() - 2
    box = f"{x},{y},{columns.max() - x + 2},{rows.max() - y + 2}"
    out = tmp_path / "out"
    status, said = verify_grab("--sim", "--small", "--seed", "4", "--roi", box, "-o", str(out))
    assert status == 0
    lines = [json.loads(line) for line in said.splitlines()]
    assert [line["type"] for line in lines][-1] == "result"
    assert lines[-1]["summary"]["plan"]["branch"]
    results = read(out / "results")
    cycles = results.table("cycles")
    assert cycles["q1_deg"].std() < 0.01
    assert "q1_ordered_deg" not in cycles
    assert len(results.table("plan")) > 100
    assert "Planned; nothing was moved" in (out / "report.html").read_text()


def test_an_end_that_is_no_success_is_told_by_the_status(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--for", "0.3s", "-o", str(out))
    status, said = verify_grab(*words)
    assert status == 1
    assert "idle" in said


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--sim", "--target", "mauve"), "mauve"),
        (("--sim", "--roi", "3,4"), "--roi"),
        (("--sim", "--for", "soon"), "--for"),
        ((), "--sim"),
        (("--sim", "--auto"), "--execute"),
        (("--sim", "--target", "red", "--roi", "1,1,9,9"), "not both"),
    ],
)
def test_bad_input_takes_one_line_and_leaves_nothing(
    tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    out = tmp_path / "out"
    with pytest.raises((InputError, Exception), match=re.escape(said)):
        verify_grab(*words, "-o", str(out))
    assert not out.exists()


def test_a_folder_that_holds_something_is_refused_before_anything_runs(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("keep")
    with pytest.raises(InputError, match="not empty"):
        verify_grab("--sim", "-o", str(tmp_path))
    assert [p.name for p in tmp_path.iterdir()] == ["mine"]


def test_keys_become_orders_and_others_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    read, write = os.pipe()
    os.write(write, b"G\nx\nh\nq\n")
    os.close(write)
    keys = Keys(read)
    end = time.monotonic() + 5.0
    while not keys.quit and time.monotonic() < end:
        time.sleep(0.005)
    assert keys.quit
    assert list(keys.pressed()) == [Event.GRAB, Event.HOLD]
    assert keys.pressed() == []
    assert '"x" is no key' in capsys.readouterr().err


@pytest.mark.slow
def test_turning_bases_are_recorded_as_they_stood(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("--sim", "--execute", "--auto", "--small", "--seed", "4", "--turning", "-o", str(out))
    status, said = verify_grab(*words)
    assert status == 0
    assert "holding-stale" in said
    pans = [math.degrees(pair.pan_left) for pair in open_session(out / "session").pairs()]
    stood = [pans[0], pans[0] + 3.0, pans[0] - 2.0]
    assert all(min(abs(pan - angle) for angle in stood) < 0.02 for pan in pans)
    assert all(min(abs(pan - angle) for pan in pans) < 0.02 for angle in stood)
