"""A Dask cluster gives the same bytes as one process, and a killed worker costs only time."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.command import verify
from tests.support.fleets import record
from tests.support.processes import TIMEOUT, wait_until
from verify.errors import InputError
from verify.fleet.batch.cluster import Cluster

distributed = pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore"),  # dask's and tornado's own, as workers come and go
]
TABLES = ("sessions.parquet", "frames.parquet", "failures.csv", "fleet.html", "fleet.pdf")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    for seed in range(1, 4):
        record(folder / f"session {seed}", seed, day=seed)
    (folder / "bad").mkdir()
    (folder / "bad" / "session.toml").write_text("format = 1\n")
    return folder


@pytest.fixture(scope="module")
def alone(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("alone") / "out"
    assert verify("batch", lab, "-o", out, "--workers", "1", "--quiet").status in (1, 3, 4)
    return out


def assert_same(one: Path, other: Path) -> None:
    for name in TABLES:
        assert bool((one / name).read_bytes() == (other / name).read_bytes()), name


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Start a process of Dask's as by hand; all are sent home at the end."""
    running: list[subprocess.Popen[bytes]] = []

    def started(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        with (tmp_path / f"log-{len(running)}").open("wb") as log:
            process = subprocess.Popen(command, stdout=log, stderr=log, cwd=tmp_path)
        running.append(process)
        return process

    yield started
    for process in reversed(running):
        process.terminate()
    for process in running:
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def test_a_scheduler_and_workers_by_hand_one_of_them_killed_midway(
    lab: Path, alone: Path, tmp_path: Path, start: Callable[..., subprocess.Popen[bytes]]
) -> None:
    output = tmp_path / "scheduler.json"
    start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
          "--scheduler-file", str(output))  # fmt: skip
    workers = [
        start("worker", "--scheduler-file", str(output), "--nthreads", "1", "--no-dashboard",
              "--host", "127.0.0.1", "--no-nanny", "--local-directory", str(tmp_path / "dask"))
        for _ in range(2)
    ]  # fmt: skip
    wait_until(output.exists)
    address = str(json.loads(output.read_text())["address"])
    out = tmp_path / "out"
    batch = subprocess.Popen(
        [sys.executable, "-m", "verify", "batch", str(lab), "-o", str(out), "--scheduler", address],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    wait_until(lambda: out.is_dir() and any((out / "sessions").glob("[!.]*/entry.json")))
    os.kill(workers[0].pid, signal.SIGKILL)
    assert batch.wait(3 * TIMEOUT) in (1, 3, 4)
    assert_same(alone, out)


def test_an_address_without_an_answer_is_refused_in_one_line() -> None:
    with pytest.raises(InputError) as problem:
        Cluster("nonsense://nowhere")
    assert "\n" not in str(problem.value)
