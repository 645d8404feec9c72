"""`verify batch` as a user types it."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import pytest

import reports
from tests.support.command import ROOT, SAMPLES, read_summary, verify
from tests.support.fleets import record
from tests.support.processes import TIMEOUT, running, wait_until
from verify.simulation.scenario import ScenarioFault

TABLES = ("sessions.parquet", "frames.parquet", "failures.csv")
REPORTS = ("fleet.html", "fleet.pdf")
SESSIONS = 8
REPAIRED = 5  # the first session after the encoder of joint 2 was knocked, from 1
DASK = pytest.mark.filterwarnings("ignore")  # its own and tornado's, as workers come and go
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One arm through pixels, a session a fortnight; joint 2 reads 0.3° more from the fifth on."""
    folder = tmp_path_factory.mktemp("data") / "lab"
    for number in range(1, SESSIONS + 1):
        fault = ScenarioFault(joint=2, offset_deg=0.3) if number >= REPAIRED else None
        record(folder / f"{number:02d}", number, fault, day=14.0 * number)
    return folder


@pytest.fixture(scope="module")
def out(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "fleet"
    done = verify("batch", lab, "-o", out, "--workers", "2", "--tolerance", "0.2")
    assert done.status == 1, done.err
    return out


@pytest.fixture
def without_pdf(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare the seconds that a PDF takes where it is not what the test is about."""
    monkeypatch.setattr("reports.format.pdf.pages", lambda *_: b"%PDF-")


def tables(out: Path) -> dict[str, bytes]:
    return {name: (out / name).read_bytes() for name in (*TABLES, *REPORTS)}


def assert_same(one: dict[str, bytes], other: dict[str, bytes]) -> None:
    for name, content in one.items():
        assert bool(content == other[name]), name


def test_figures_are_those_of_verify_run(lab: Path, out: Path, tmp_path: Path) -> None:
    place = tmp_path / "run"
    verify("run", lab / "03", "-o", place, "--tolerance", "0.2", "--quiet")
    summary = read_summary(place)
    sessions = pd.read_parquet(out / "sessions.parquet").set_index("session")
    row = sessions.loc[str(lab / "03")]
    for joint in summary["joints"]:
        for key in joint.keys() - {"joint"}:
            assert row[f"q{joint['joint']}_{key}"] == joint[key], key
    frames = pd.read_parquet(out / "frames.parquet")
    own = frames[frames["session"] == str(lab / "03")].drop(columns="session")
    plain = pd.read_parquet(place / "results" / "frames.parquet")
    pd.testing.assert_frame_equal(
        own.reset_index(drop=True), plain, check_exact=True, check_dtype=False
    )


def test_the_report_names_the_joint_and_dates_the_step_to_its_session(lab: Path, out: Path) -> None:
    changes = pd.read_parquet(out / "results" / "changes.parquet")
    (found,) = changes.to_dict("records")
    assert (found["joint"], found["kind"]) == (2, "step")
    assert found["session"] == str(lab / f"{REPAIRED:02d}")
    assert abs(found["size"] - 0.3) < 0.05
    page = (out / "fleet.html").read_text()
    assert "The reading of joint 2 of iust_6r changed by +" in page


def test_started_again_nothing_is_measured_and_the_bytes_are_the_same(lab: Path, out: Path) -> None:
    before = tables(out)
    assert {path.name for path in out.iterdir()} == {*before, "sessions", "results"}
    again = verify("batch", lab, "-o", out, "--workers", "1", "--tolerance", "0.2")
    assert again.status == 1
    assert f"0 sessions measured, {SESSIONS} kept from before, 0 failed" in again.out
    assert_same(before, tables(out))
    for name in REPORTS:
        (out / name).unlink()
    assert verify("report", out).status == 0
    assert not (out / "report.html").exists()
    assert_same(before, tables(out))


@pytest.mark.usefixtures("without_pdf")
def test_json_gives_one_object_a_line_and_a_day_divides_the_fleet(
    lab: Path, out: Path, tmp_path: Path
) -> None:
    place = tmp_path / "fleet"
    shutil.copytree(out, place)
    words = ("-o", place, "--tolerance", "0.2", "--since", "2025-03-05", "--json")
    message = verify("batch", lab, *words)
    lines = [json.loads(line) for line in message.out.splitlines()]
    progress = [line for line in lines if line["type"] == "progress"]
    assert progress[-1]["done"] == progress[-1]["sessions"] == SESSIONS
    assert set(progress[0]) >= {"pairs_per_s", "time_left_s", "failures", "kept"}
    assert lines[-1]["type"] == "result"
    assert lines[-1]["summary"]["kind"] == "fleet"
    table = pd.read_parquet(place / "results" / "contrasts.parquet")
    assert table[table["shown"]]["joint"].tolist() == [2]
    assert "since 2025-03-05" in (place / "fleet.html").read_text()


@pytest.mark.usefixtures("without_pdf")
def test_the_report_names_failed_sessions_as_they_are_called(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names = ["001", "1e3", "=1+1"]
    for name in names:  # a number or a formula, to who reads failures.csv
        Path(name).mkdir()
        Path(name, "session.toml").write_text("")
    done = verify("batch", *names, lab / "01", "-o", "out", "--workers", "1")
    assert done.status == 4, done.err
    assert reports.read(Path("out/results")).table("failures")["session"].tolist() == names


@pytest.mark.slow
def test_session_reports_are_written_and_linked(lab: Path, tmp_path: Path) -> None:
    some = tmp_path / "some"
    shutil.copytree(lab / "01", some / "01")
    place = tmp_path / "fleet"
    verify("batch", some, "-o", place, "--workers", "1", "--reports", "--quiet")
    (own,) = (place / "sessions").iterdir()
    written = {path.name for path in own.iterdir()}
    assert written >= {"report.html", "report.pdf", "summary.json", "frames.csv", "results"}
    assert f'href="sessions/{own.name}/report.html"' in (place / "fleet.html").read_text()


@pytest.fixture
def heap(lab: Path, tmp_path: Path) -> Path:
    """Sessions spoilt in every way, and two that are not."""
    heap = tmp_path / "heap"
    shutil.copytree(lab / "02", heap / "good 2")
    for name in ("good 1", "cut", "schema", "sparse", 'a,"b"\n<script>x</script>'):
        shutil.copytree(lab / "01", heap / name)
    video = heap / "cut" / "left.mkv"
    video.write_bytes(video.read_bytes()[: video.stat().st_size // 2])
    (heap / "schema" / "session.toml").write_text('format = "one"\nrobot = 7\n')
    sparse = heap / "sparse" / "right.mkv"
    sparse.unlink()
    with sparse.open("wb") as file:
        file.truncate(4 * 2**30)
    (heap / 'a,"b"\n<script>x</script>' / "frames.csv").write_text("frame,t_left_s\n0,0\n")
    (heap / "circle").symlink_to("circle")
    return heap


@pytest.mark.slow
@pytest.mark.usefixtures("without_pdf")
def test_each_broken_session_is_reported_and_the_others_are_measured(
    heap: Path, tmp_path: Path
) -> None:
    place = tmp_path / "fleet"
    done = verify("batch", heap, "-o", place, "--workers", "2", "--tolerance", "5")
    assert done.status == 4, done.err
    assert "Traceback" not in done.err
    sessions = pd.read_parquet(place / "sessions.parquet")
    assert sessions["session"].tolist() == [f"{heap}/good 1", f"{heap}/good 2"]
    assert set(sessions["verdict"]) == {"conform"}
    failures = pd.read_csv(place / "failures.csv").set_index("session")
    failures.index = failures.index.str.removeprefix(f"{heap}/")
    refused = ['a,"b"\n<script>x</script>', "cut", "schema", "sparse"]
    assert failures["kind"].to_dict() == {
        "circle": "unreadable", **dict.fromkeys(refused, "refused")
    }  # fmt: skip
    assert all("\n" not in why for why in failures["why"])
    assert "left.mkv" in failures.loc["cut", "why"]
    assert "right.mkv" in failures.loc["sparse", "why"]
    assert "<script>x" not in (place / "fleet.html").read_text()


def test_where_no_session_can_be_measured_failures_are_written_and_nothing_else(
    heap: Path, tmp_path: Path
) -> None:
    place = tmp_path / "fleet"
    done = verify("batch", heap / "schema", "-o", place, "--workers", "1", "--quiet")
    assert "none of its 1 sessions could be measured" in done.refusal
    assert not (place / "sessions.parquet").exists()
    assert len(pd.read_csv(place / "failures.csv")) == 1


@pytest.mark.parametrize(
    "words",
    [
        ("nowhere",),
        (".", "--since", "yesterday"),
        (".", "--by", "colour"),
        (".", "--compare", "s", "elsewhere"),
        (".", "--compare", "s", "s"),
        (".", "--workers", "0"),
        *((SAMPLES, "-o", "out", f"--tolerance={wrong}")
          for wrong in ("abc", "nan", "0", "0.2,0.2")),
        (SAMPLES, "-o", "out", "--position-tolerance=-1"),
        (".", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2"),
        pytest.param((".", "--scheduler", "nonsense://nowhere"), marks=DASK),
        (),
    ],
)  # fmt: skip
def test_wrong_usage_takes_one_line(
    words: tuple[str | Path, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "session.toml").write_text("")
    done = verify("batch", *words)
    assert done.refusal == done.err.strip()
    assert [path.name for path in tmp_path.iterdir()] == ["s"]


@pytest.mark.parametrize("name", ["sessions", "fleet.pdf"])
def test_what_stands_in_the_way_of_a_result_is_named_first(
    name: str, lab: Path, tmp_path: Path
) -> None:
    obstacle = tmp_path / name
    obstacle.mkdir() if "." in name else obstacle.touch()
    assert verify("batch", lab, "-o", tmp_path).refusal.startswith(f"error: {obstacle}: is a ")
    assert list(tmp_path.iterdir()) == [obstacle]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a Python module as by hand; all are ended after the test."""
    processes: list[subprocess.Popen[bytes]] = []
    here = {**os.environ, "PYTHONPATH": str(ROOT)}

    def started(module: str, *words: str | Path) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", module, *map(str, words)]
        with (tmp_path / f"log-{len(processes)}").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path, env=here)
        processes.append(process)
        return process

    yield started
    for process in reversed(processes):
        process.terminate()
    for process in processes:
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def wait_for_a_session(place: Path) -> None:
    wait_until(lambda: any((place / "sessions").glob("[!.]*/entry.json")))


def workers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(c) for c in children if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "kill"])
def test_an_interrupted_batch_keeps_what_was_done_and_goes_on_from_there(
    lab: Path, out: Path, tmp_path: Path, start: Start, sent: signal.Signals
) -> None:
    place = tmp_path / "fleet"
    words = (lab, "-o", place, "--workers", "2", "--tolerance", "0.2")
    process = start("verify", "batch", *words)
    wait_for_a_session(place)
    workers = workers_of(process.pid)
    assert len(workers) == 2
    for one in [process.pid, *(workers if sent == signal.SIGINT else [])]:
        os.kill(one, sent)  # Ctrl-C reaches all that the terminal has started
    assert process.wait(TIMEOUT) == 130
    message = (tmp_path / "log-0").read_text()
    assert message.splitlines()[-1] == "interrupted"
    assert not any(running(worker) for worker in workers)
    assert {path.name for path in place.iterdir()} == {"sessions"}
    again = verify("batch", *words)
    kept = int(again.out.split(" kept from before")[0].rsplit(" ", 1)[1])
    assert kept >= 1
    assert_same(tables(out), tables(place))


@pytest.mark.slow
@DASK
def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(
    lab: Path, out: Path, tmp_path: Path, start: Start
) -> None:
    pytest.importorskip("distributed")
    output, place = tmp_path / "scheduler.json", tmp_path / "fleet"
    here = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", output)
    start("distributed.cli.dask_scheduler", "--port", "0", *here)
    own = ("--nthreads", "1", "--no-nanny", "--local-directory", tmp_path / "dask")
    workers = [start("distributed.cli.dask_worker", *here, *own) for _ in range(2)]
    wait_until(output.exists)
    address = str(json.loads(output.read_text())["address"])
    words = (lab, "-o", place, "--tolerance", "0.2", "--scheduler", address, "--quiet")
    batch = start("verify", "batch", *words)
    wait_for_a_session(place)
    os.kill(workers[0].pid, signal.SIGKILL)
    assert batch.wait(3 * TIMEOUT) == 1
    assert_same(tables(out), tables(place))
