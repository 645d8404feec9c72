"""`verify doctor`: what works, what is doubtful, what does not work."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.support.command import verify
from tests.support.devices.bench import running
from tests.support.devices.camera_server import CameraServer
from tests.support.recorded import MARKER, RIG
from verify.cli.doctor import machine
from verify.core import native
from verify.live.station import file
from verify.simulation.emulators.encoders import LabencEngine, LabencOptions
from verify.simulation.emulators.trajectory import load


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small file tells the disk's speed well enough here."""
    monkeypatch.setattr(machine, "TEST_FILE_SIZE", 2)
    monkeypatch.setattr("verify.cli.doctor.devices.START_TIMEOUT", 2.0)


def examined(*words: str | Path) -> tuple[int, dict[str, dict[str, Any]]]:
    """Exit status, and the findings by what was checked."""
    done = verify("doctor", *words, "--json")
    lines = [json.loads(line) for line in done.out.splitlines()]
    return done.status, {line["what"]: line for line in lines if line["type"] == "check"}


def test_a_machine_is_checked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    status, found = examined()
    assert status == 0
    assert "Python" in found["versions"]["text"]
    recorded = [
        f"recording {kind}" for kind in ("grey pictures", "colour pictures", "JPEGs as they come")
    ]
    assert {found[what]["outcome"] for what in (*recorded, "FFV1")} == {"works"}
    assert found["inner loops"]["outcome"] == "works"
    assert str(tmp_path) in found["disk"]["text"]
    assert {"serial ports", "cameras"} <= found.keys()
    assert list(tmp_path.iterdir()) == []


def test_a_machine_without_a_compiler_is_told_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refused(*_arrays: object) -> None:
        native.compiler()

    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "")
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    monkeypatch.setattr(machine, "rotation_vectors", refused)
    status, found = examined()
    assert (status, found["inner loops"]["outcome"]) == (1, "fails")
    assert "the Python package ziglang" in found["inner loops"]["text"]


@pytest.mark.realtime
def test_a_simulated_station_works(tmp_path: Path) -> None:
    (tmp_path / "station.toml").write_text(file.template())
    status, found = examined(tmp_path / "station.toml")
    assert status == 0
    for side in ("left camera", "right camera"):
        assert found[side]["outcome"] == "works"
        assert found[side]["size"] == [1280, 720]
        assert found[side]["rate_hz"] == pytest.approx(30, rel=0.05)
    assert found["encoders"]["rate_hz"] == pytest.approx(100, rel=0.05)
    assert found["pan bases"]["outcome"] == "works"


@pytest.mark.realtime
def test_settings_that_are_refused_are_doubtful(tmp_path: Path) -> None:
    text = file.template().replace("# gain = 0  ", "gain = 3  ", 1)
    (tmp_path / "station.toml").write_text(text)
    status, found = examined(tmp_path / "station.toml")
    assert status == 0
    assert found["left camera"]["outcome"] == "doubt"
    assert "gain 3" in found["left camera"]["text"]
    assert found["right camera"]["outcome"] == "works"


@pytest.mark.realtime
def test_devices_on_the_network_are_tried_and_the_missing_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "marker.toml").write_text(MARKER)
    engine = LabencEngine(load("sweep", 6), 6, LabencOptions())
    with closing(CameraServer()) as camera, running(engine) as board:
        (tmp_path / "station.toml").write_text(
            f'format = 1\nrobot = "iust_6r"\nrig = "rig.toml"\nmarker = "marker.toml"\n'
            f'[left]\nsource = "{camera.url}"\n'
            '[right]\nsource = "http://127.0.0.1:9/video"\n'
            f'[encoders]\ndriver = "labenc"\nport = "{board.address}"\n'
        )
        status, found = examined(tmp_path / "station.toml")
    assert status == 1
    assert "JPEGs kept as they come" in found["left camera"]["text"]
    assert found["right camera"]["outcome"] == "fails"
    assert "not connected: connection refused" in found["right camera"]["text"]
    assert found["encoders"]["outcome"] == "works"
    # a busy machine reads in lumps
    assert found["encoders"]["rate_hz"] == pytest.approx(100, rel=0.5)


def test_a_station_file_that_cannot_be_used_is_bad_input(tmp_path: Path) -> None:
    assert "no such file" in verify("doctor", tmp_path / "station.toml").refusal
