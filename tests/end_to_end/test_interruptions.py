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


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "kill"])
def test_an_interrupted_run_reports_it_and_writes_nothing(
    sent: signal.Signals, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*COMMAND, str(SESSION), "-o", str(out)], stderr=subprocess.PIPE, text=True
    )
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
@pytest.mark.parametrize("earlier", [False, True], ids=["new", "forced"])
def test_an_interruption_while_writing_leaves_what_was_there(
    step: str,
    earlier: bool,
    measurements: list[Measurement],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    if earlier:
        out.mkdir()
        (out / "summary.json").write_text("earlier")
    monkeypatch.setattr(f"reports.{step}", interrupted)
    with replayed(measurements):
        outcome = verify("run", SESSION, "-o", out, "--quiet", *["--force"] * earlier)
    assert outcome.status == 130
    left = {path.name: path.read_text() for path in tmp_path.rglob("*") if path.is_file()}
    assert left == ({"summary.json": "earlier"} if earlier else {})
    assert out.exists() == earlier


FULL = ("size=16k", "size=300k", "size=2m")  # at the tables, the picture, the HTML


@pytest.mark.parametrize(
    "option", [*(pytest.param(size, marks=pytest.mark.slow) for size in FULL), "ro"]
)
def test_a_disk_that_is_full_or_read_only_is_one_line_and_leaves_nothing(
    option: str, measurements: list[Measurement], tmp_path: Path
) -> None:
    with mounted(tmp_path / "disk", "-o", option) as disk, replayed(measurements):
        outcome = verify("run", SESSION, "-o", disk / "out")
        left = list(disk.iterdir())
    assert "out" in outcome.refusal
    assert option == "ro" or "space" in outcome.refusal
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
        refusal = verify("report", disk / "out").refusal
        assert "report.html" in refusal
        assert "space" in refusal
        for file in out.rglob("*.*"):
            assert (disk / "out" / file.relative_to(out)).read_bytes() == file.read_bytes()
        assert len(list((disk / "out").iterdir())) == len(list(out.iterdir()))
