"""Stopped midway, or refused by the disk: one line, the right status, nothing half-written."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import robots
from tests.support.command import SAMPLES, remembered, replayed, verify
from tests.support.small_disk import mounted
from verify import analyse, open_session
from verify.cli.watch import stop_on_signal
from verify.core.records import Measurement

SESSION = SAMPLES / "quarter_circle_6r"
PATIENCE = 60.0  # s; a busy machine is slow to import
COMMAND = [sys.executable, "-m", "verify", "run"]


@pytest.fixture(scope="module")
def measurements() -> list[Measurement]:
    with remembered() as seen:
        analyse(open_session(SESSION))
    return seen


@pytest.fixture(autouse=True)
def terminal() -> Iterator[None]:
    """A terminal's end is not ignored, as it is where nohup runs the tests."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
@pytest.mark.parametrize(
    "sent",
    [signal.SIGINT, signal.SIGTERM, signal.SIGHUP],
    ids=["Ctrl-C", "kill", "terminal closed"],
)
def test_an_interrupted_run_reports_it_and_writes_nothing(
    sent: signal.Signals, tmp_path: Path
) -> None:
    words = [*COMMAND, str(SESSION), "-o", str(tmp_path / "out")]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
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


@pytest.mark.parametrize(
    ("sent", "times"), [(signal.SIGINT, 1), (signal.SIGTERM, 1), (signal.SIGHUP, 2)]
)
def test_a_watch_is_asked_to_end_with_its_report(sent: signal.Signals, times: int) -> None:
    """A shell passes on to its jobs that the terminal has closed: they hear of it twice."""
    before = signal.getsignal(sent)
    with stop_on_signal() as stop:
        for _ in range(times):
            signal.raise_signal(sent)
        assert stop.is_set()
    assert signal.getsignal(sent) is before


@pytest.mark.slow
def test_ctrl_c_at_any_moment_ends_a_run_in_a_word(tmp_path: Path) -> None:
    for delay in np.linspace(0.5, 4.0, 10):  # before, it is Python that loads
        words = [*COMMAND, str(SESSION), "-o", str(tmp_path / "out"), "--quiet"]
        process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        time.sleep(delay)
        running = process.poll() is None
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE)
        if running and process.returncode not in (0, 3):  # it may just have ended
            assert (process.returncode, err) == (130, "interrupted\n"), delay
            assert list(tmp_path.iterdir()) == []
        shutil.rmtree(tmp_path / "out", ignore_errors=True)


def test_a_second_ctrl_c_at_the_very_end_keeps_the_status() -> None:
    script = """
import atexit, signal, sys, time
from verify import __main__
from verify.cli import main
class Slow:
    def __del__(self, sleep=time.sleep):
        sleep(1.0)
sys.slow = Slow()
def interrupted(words):
    atexit.register(signal.raise_signal, signal.SIGINT)
    return 130
main._status = interrupted
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "")


def test_a_second_ctrl_c_while_the_first_is_answered_keeps_the_status() -> None:
    script = """
from verify import __main__
from verify.cli import main
def interrupted(words):
    raise main.CommandInterrupt
main._status = interrupted
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "")


class Swallows:
    """An exception in here is printed, and gone."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.01)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interruption_that_a_callback_swallows_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def swallowed(*_: object, **__: object) -> None:
        Swallows()
        time.sleep(PATIENCE)

    monkeypatch.setattr("verify.cli.measure.open_session", swallowed)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert verify("run", SESSION, "-o", tmp_path / "out").status == 130
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("kilobytes", [700_000, 1_000_000, 1_400_000])
def test_too_little_memory_is_said_as_such(kilobytes: int, tmp_path: Path) -> None:
    words = [*COMMAND, str(SESSION), "-o", str(tmp_path / "out")]
    limited = f"ulimit -v {kilobytes}; ulimit -c 0; exec {shlex.join(words)} --quiet"
    done = subprocess.run(["bash", "-c", limited], capture_output=True, text=True)
    (line,) = done.stderr.splitlines()
    assert (done.returncode, line.count("cannot allocate memory")) == (2, 1), done


@pytest.mark.parametrize("step", ["format.html.page", "format.pdf.pages", "write"])
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


@pytest.mark.parametrize(
    ("words", "streams", "status"),
    [
        ("--version", ">&-", 0),
        ("robots iust_6r", "<&- >&- 2>&-", 0),
        ("robots iust_6r", "| true", 0),
        ("robots nosuch", "2>&-", 2),
        ("robots nosuch", "2>/dev/full", 2),
        ("robots nosuch", "2>&1 | true", 2),
        ("robots iust_6r", ">/dev/full", 2),
    ],
)
def test_a_stream_that_nobody_reads_does_not_change_the_status(
    words: str, streams: str, status: int
) -> None:
    command = f"{shlex.quote(sys.executable)} -m verify {words} {streams}"
    script = f"{command}; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_characters_that_a_stream_cannot_hold_are_replaced(encoding: str) -> None:
    script = "import sys; from verify.cli import main; from verify import __main__; "
    script += "main.main = lambda: print('α = 1.00° ± 0.10°'); __main__.main()"
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, env=environment)
    text = "α = 1.00° ± 0.10°\n".encode(encoding, errors="replace")
    assert (done.returncode, done.stdout, done.stderr) == (0, text, b"")


def test_what_libraries_print_themselves_is_not_shown(tmp_path: Path) -> None:
    text = robots.library.example(robots.library.EXAMPLES["ur5"]).read_text()
    (tmp_path / "arm.urdf").write_text(re.sub('ixx="[^"]+"', 'ixx="nan"', text))
    words = [sys.executable, "-m", "verify", "robots", str(tmp_path / "arm.urdf")]
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    verbose = subprocess.run([*words, "--verbose"], capture_output=True, text=True)
    assert "inertia" in verbose.stderr  # urdfdom's own words


@pytest.mark.parametrize(
    ("ending", "status", "words"),
    [("sys.exit(70)", 70, "last words"), ("os.abort()", -signal.SIGABRT, "Aborted")],
)
def test_what_was_printed_past_python_is_shown_of_a_crash(
    ending: str, status: int, words: str
) -> None:
    script = f"""
import os, sys
from verify import __main__
from verify.cli import main
def crash():
    os.write(2, b"last words\\n")
    {ending}
main.main = crash
__main__.main()
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == status
    assert words in done.stderr
