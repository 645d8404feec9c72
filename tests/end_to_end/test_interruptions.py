"""Stopped midway, or refused by the disk: one line, the right status, nothing half-written."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.command import SAMPLES, remembered, replayed, verify
from tests.support.small_disk import mounted
from verify import analyse, open_session
from verify.core.records import Measurement

SESSION = SAMPLES / "quarter_circle_6r"
PATIENCE = 60.0  # s; a busy machine is slow to import
COMMAND = [sys.executable, "-c", "from verify.cli.main import main; main()", "run"]


@pytest.fixture(scope="module")
def measurements() -> list[Measurement]:
    with remembered() as seen:
        analyse(open_session(SESSION))
    return seen


def assert_refused(status: int, err: str, *named: str) -> None:
    assert status == 2
    assert "Traceback" not in err
    (message,) = [line for line in err.splitlines() if line.startswith("error:")]
    for word in named:
        assert word in message


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "kill"])
def test_an_interrupted_run_reports_it_and_writes_nothing(
    sent: signal.Signals, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*COMMAND, str(SESSION), "-o", str(out)], stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    began = time.monotonic()
    while "pairs:" not in process.stderr.readline():  # the chain is at work
        assert process.poll() is None
        assert time.monotonic() < began + PATIENCE
    process.send_signal(sent)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    assert err.splitlines()[-1] == "interrupted"
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("step", ["render_html", "render_pdf", "write"])
def test_an_interruption_while_writing_leaves_nothing_either(
    step: str, measurements: list[Measurement], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"reports.{step}", interrupted)
    with replayed(measurements):
        outcome = verify("run", SESSION, "-o", tmp_path / "out", "--quiet")
    assert outcome.status == 130
    assert list(tmp_path.iterdir()) == []


def test_forced_over_earlier_results_an_interruption_leaves_those(
    measurements: list[Measurement], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "summary.json").write_text("earlier")

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("reports.render_pdf", interrupted)
    with replayed(measurements):
        outcome = verify("run", SESSION, "-o", tmp_path, "--force", "--quiet")
    assert outcome.status == 130
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
    assert (tmp_path / "summary.json").read_text() == "earlier"


@pytest.mark.slow
@pytest.mark.parametrize("size", ["16k", "300k", "2m"])  # full at the tables, the picture, the HTML
def test_a_full_disk_is_one_line_and_leaves_nothing(
    size: str, measurements: list[Measurement], tmp_path: Path
) -> None:
    with mounted(tmp_path / "disk", "-o", f"size={size}") as disk, replayed(measurements):
        outcome = verify("run", SESSION, "-o", disk / "out")
        left = list(disk.iterdir())
    assert_refused(outcome.status, outcome.err, "out", "space")
    assert left == []


def test_a_disk_that_fills_up_under_a_report_keeps_the_old_one(
    measurements: list[Measurement], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    with replayed(measurements):
        assert verify("run", SESSION, "-o", out, "--quiet").status in (0, 3)
    whole = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    room = f"size={whole + 200_000}"  # for all of it once, not for one more report.html
    with mounted(tmp_path / "disk", "-o", room) as disk:
        shutil.copytree(out, disk / "out")
        outcome = verify("report", disk / "out")
        assert_refused(outcome.status, outcome.err, "report.html", "space")
        for file in out.rglob("*.*"):
            assert (disk / "out" / file.relative_to(out)).read_bytes() == file.read_bytes()
        assert len(list((disk / "out").iterdir())) == len(list(out.iterdir()))


def test_a_place_that_may_not_be_written_is_refused_in_one_line(
    measurements: list[Measurement], tmp_path: Path
) -> None:
    with mounted(tmp_path / "disk", "-o", "ro") as disk, replayed(measurements):
        outcome = verify("run", SESSION, "-o", disk / "out")
        left = list(disk.iterdir())
    assert_refused(outcome.status, outcome.err, "out")
    assert left == []
