"""`verify doctor`: what works, what is doubtful, what does not work."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.devices.camera_server import CameraServer
from tests.support.recorded import MARKER, RIG
from verify.cli.doctor import machine
from verify.cli.doctor.doctor import doctor
from verify.cli.terminal import terminal
from verify.devices.ports import SerialLine
from verify.errors import InputError
from verify.live.station import file
from verify.simulation.emulators.encoders import LabencEngine, LabencOptions
from verify.simulation.emulators.server import EmulatorFaults, EmulatorServer, open_front
from verify.simulation.emulators.trajectory import load


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A small file tells the disk's speed well enough here; JSON can be read."""
    monkeypatch.setattr(machine, "TEST_FILE_SIZE", 2)
    monkeypatch.setattr("verify.cli.doctor.devices.START_TIMEOUT", 2.0)
    terminal.as_json = True
    yield
    terminal.as_json = False


def findings(capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, object]]:
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    return {line["what"]: line for line in lines if line["type"] == "check"}


def test_a_machine_is_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert doctor() == 0
    found = findings(capsys)
    assert "Python" in str(found["versions"]["text"])
    for what in ("recording grey pictures", "recording colour pictures", "FFV1"):
        assert found[what]["outcome"] == "works"
    assert found["recording JPEGs as they come"]["outcome"] == "works"
    assert str(tmp_path) in str(found["disk"]["text"])
    assert {"serial ports", "cameras"} <= found.keys()
    assert list(tmp_path.iterdir()) == []


def test_a_simulated_station_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "station.toml").write_text(file.template())
    assert doctor(tmp_path / "station.toml") == 0
    found = findings(capsys)
    for side in ("left camera", "right camera"):
        assert found[side]["outcome"] == "works"
        assert found[side]["size"] == [1280, 720]
        assert found[side]["rate_hz"] == pytest.approx(30, rel=0.05)
    assert found["encoders"]["rate_hz"] == pytest.approx(100, rel=0.05)
    assert found["pan bases"]["outcome"] == "works"


def test_settings_that_are_refused_are_doubtful(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = file.template().replace("# gain = 0  ", "gain = 3  ", 1)
    (tmp_path / "station.toml").write_text(text)
    assert doctor(tmp_path / "station.toml") == 0
    found = findings(capsys)
    assert found["left camera"]["outcome"] == "doubt"
    assert "gain 3" in str(found["left camera"]["text"])
    assert found["right camera"]["outcome"] == "works"


@pytest.mark.realtime
def test_devices_on_the_network_are_tried_and_the_missing_one_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "marker.toml").write_text(MARKER)
    camera = CameraServer()
    engine = LabencEngine(load("sweep", 6), 6, LabencOptions())
    board = EmulatorServer(open_front("tcp:0", SerialLine()), engine, EmulatorFaults(), None, 0)
    ending = threading.Event()
    served = threading.Thread(target=board.serve, args=(ending.is_set,), daemon=True)
    served.start()
    (tmp_path / "station.toml").write_text(
        f'format = 1\nrobot = "iust_6r"\nrig = "rig.toml"\nmarker = "marker.toml"\n'
        f'[left]\nsource = "{camera.url}"\n'
        '[right]\nsource = "http://127.0.0.1:9/video"\n'
        f'[encoders]\ndriver = "labenc"\nport = "{board.front.address}"\n'
    )
    try:
        assert doctor(tmp_path / "station.toml") == 1
    finally:
        ending.set()
        served.join(5)
        board.close()
        camera.close()
    found = findings(capsys)
    assert "JPEGs kept as they come" in str(found["left camera"]["text"])
    assert found["right camera"]["outcome"] == "fails"
    assert "not connected: connection refused" in str(found["right camera"]["text"])
    assert found["encoders"]["outcome"] == "works"
    assert found["encoders"]["rate_hz"] == pytest.approx(
        100, rel=0.5
    )  # a busy machine reads in lumps


def test_a_station_file_that_cannot_be_used_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        doctor(tmp_path / "station.toml")
