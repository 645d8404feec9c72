"""A station from `--new-station` for each controller, watched from end to end with its emulator.

The emulator plays the simulated arm's own motion, so every joint's true error is zero.
"""

import time
from pathlib import Path

import pytest

from tests.support.command import verify
from tests.support.devices.bench import emulate_command
from tests.support.devices.emulated_station import emulator, start_beside
from tests.support.watched import Run, listen
from verify.io.session.session import open_session

SCENARIO = "multi_joint_ur5"
ADDRESSES = {
    "rtde": "tcp:192.168.0.20:30004",
    "rosbridge": "ws://192.168.0.20:9090",
    "opcua": "opc.tcp://192.168.0.20:4840",
}


def station(folder: Path, driver: str, address: str) -> Path:
    """Write the station as a user does, slower, with the emulator's address."""
    path = folder / "station.toml"
    done = verify("run", "--new-station", path, "--robot", "ur5", "--driver", driver)
    assert done.status == 0
    text = path.read_text()
    assert ADDRESSES[driver] in text
    path.write_text(text.replace(ADDRESSES[driver], address).replace("= 30.0", "= 10.0"))
    return path


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize(
    "driver",
    ["rtde", *(pytest.param(d, marks=pytest.mark.long) for d in ("rosbridge", "opcua"))],
)
def test_a_watch_of_each_controller_finds_no_error_where_there_is_none(
    tmp_path: Path, driver: str
) -> None:
    began = time.monotonic()
    with emulator(driver, "tcp:0", began, scenario=SCENARIO) as (address, go):
        go()
        process = start_beside(station(tmp_path, driver, address), began, 12.0, page=False)
        run = listen(process, Run())
    assert not run.told("change"), run.alarms
    assert run.worst() < 6.0
    measured = [pair for pair in run.pairs if pair["status"] == "measured"]
    assert len(measured) > 0.5 * len(run.pairs)
    assert [p["clock"]["source"] for p in run.pairs if p["clock"]][-1] == "estimated"
    (folder,) = (tmp_path / "recordings").iterdir()
    assert len(open_session(folder)) == len(run.pairs)
    if driver == "opcua":  # one suffices: a recording does not know its driver
        done = verify("run", folder, "-o", tmp_path / "report", "--tolerance", "1.0")
        assert done.status in (0, 3), done  # nothing is out of tolerance
        assert (tmp_path / "report" / "report.html").exists()


@pytest.mark.realtime
def test_the_doctor_says_what_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("verify.cli.doctor.machine.TEST_FILE_SIZE", 2)
    with emulate_command("rosbridge", "--port", "tcp:0", "--robot", "ur5") as address:
        done = verify("doctor", station(tmp_path, "rosbridge", address))
    (line,) = [line for line in done.out.splitlines() if " encoders: " in line]
    assert line.startswith(f"works encoders: {address}: reading; each known within ±"), line
    done = verify("doctor", tmp_path / "station.toml")
    (line,) = [line for line in done.out.splitlines() if " encoders: " in line]
    assert line.startswith(f"FAILS encoders: {address}: not connected: nothing listens there"), line
    assert done.status == 1
