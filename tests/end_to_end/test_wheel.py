"""The package as it is installed: a wheel in its own environment, away from the repository."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from tests.support.command import ROOT

MAX_WHEEL_BYTES = 8_000_000
pytestmark = pytest.mark.slow


def run(*words: str | Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command with nothing of the repository on its path."""
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [str(w) for w in words], cwd=folder, env=clean, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    sources = folder / "sources"  # setuptools leaves build/ in them
    for name in ("verify", "robots", "reports", "sample_sessions"):
        shutil.copytree(
            ROOT / name, sources / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, sources)
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "-q",
        "-w",
        folder,
        sources,
        folder=folder,
    )
    (built,) = folder.glob("verify_robot-*.whl")
    return built


def test_the_wheel_is_small_and_holds_every_file_that_the_package_reads(wheel: Path) -> None:
    assert wheel.stat().st_size < MAX_WHEEL_BYTES
    packed = set(zipfile.ZipFile(wheel).namelist())
    read = {
        (Path(folder) / name).relative_to(ROOT).as_posix()
        for package in ("verify", "robots", "reports")
        for folder, _, names in os.walk(ROOT / package, followlinks=True)
        for name in names
        if "__pycache__" not in Path(folder).parts
    }
    assert sorted(read - packed) == []


@pytest.mark.long
def test_a_fresh_environment_away_from_the_repository_runs_the_demo(
    wheel: Path, tmp_path: Path
) -> None:
    environment = tmp_path / "environment"
    venv.create(environment, symlinks=True)
    python = environment / "bin" / "python"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "-q",
        "--no-deps",
        "--no-index",
    ]
    run(*pip, wheel, folder=tmp_path)
    # packages that ours needs, out of the environment of the tests; ours itself is found first
    shared = Path(sysconfig.get_path("purelib"))
    own = next(environment.glob("lib/python*/site-packages"))
    inner = [str(path) for path in shared.glob("cmeel.prefix/lib/python*/site-packages")]
    (own / "shared.pth").write_text("\n".join([str(shared), *inner]), encoding="utf-8")

    where = (
        "import verify, robots, reports; print(verify.__file__, robots.__file__, reports.__file__)"
    )
    for file in run(python, "-c", where, folder=tmp_path).stdout.split():
        assert Path(file).is_relative_to(own)
    command = environment / "bin" / "verify"
    shown = run(command, "demo", folder=tmp_path)
    assert "Look at page one of verify-demo/report.html" in shown.stdout
    summary = json.loads((tmp_path / "verify-demo" / "summary.json").read_text())
    assert summary["verdict"] == "nonconform"
    assert summary["joints"][1]["mean_error_deg"] == pytest.approx(0.35, abs=0.005)  # simulated
    assert (tmp_path / "verify-demo" / "report.pdf").stat().st_size > 10_000
    assert "self-check: sound" in run(command, "robots", "abb_irb_120", folder=tmp_path).stdout
