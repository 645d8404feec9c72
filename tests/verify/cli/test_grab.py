"""`verify grab`: what a station file says of the controller that is moved."""

from pathlib import Path

import pytest

from verify.cli.grab.station import motion_settings
from verify.errors import InputError
from verify.live.station.keys import StationEncodersTable

STATION = Path("station.toml")


def table(**keys: object) -> StationEncodersTable:
    stated = {"driver": "melfa", "robot_type": "RV-3SD", "port": "tcp:192.168.0.20:10001"} | keys
    return StationEncodersTable(**stated)  # type: ignore[arg-type]


def test_a_controller_is_moved_in_the_way_it_is_read() -> None:
    made = motion_settings(STATION, table(terminator="CR LF", timeout_s=2.5, pause_ms=20.0))
    assert (made.terminator, made.timeout, made.pause) == (b"\r\n", 2.5, 0.02)
    usual = motion_settings(STATION, table())
    assert (usual.terminator, usual.timeout, usual.pause) == (b"\r", 1.0, 0.1)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"driver": "rtde"}, 'encoders.driver is "rtde"; only a MELFA controller can be moved'),
        ({"robot_type": None}, "encoders.robot_type is missing; another robot than it names"),
        ({"port": "/dev/ttyUSB0"}, 'encoders.port is "/dev/ttyUSB0"; the controller is moved over'),
        ({"port": None}, "encoders.port is missing"),
        ({"terminator": "LF"}, 'encoders.terminator is "LF"'),
    ],
)
def test_a_controller_that_cannot_be_moved_is_refused_by_its_key(
    keys: dict[str, object], reason: str
) -> None:
    with pytest.raises(InputError) as problem:
        motion_settings(STATION, table(**keys))
    assert reason in str(problem.value).replace(": is", " is")
