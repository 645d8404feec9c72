"""Read and check a station file, and write one with every key explained."""

import re
from datetime import datetime
from importlib import resources
from pathlib import Path
from typing import TypeVar

import msgspec

from verify.core.records import SIDES
from verify.errors import one_line
from verify.io.session.keys import check_clock, tolerance
from verify.io.toml import decode, did_you_mean, key_error, one_of
from verify.live.station.devices import ENCODER_KEYS, PAN_KEYS
from verify.live.station.keys import EVENT_KINDS, HOST_AND_PORT, StationCameraTable, StationTable

SIM = "sim"
_MQTT = rf"mqtt://([^\s/@]+@)?{HOST_AND_PORT}?/[^\s/]\S*"


T = TypeVar("T", bound=StationTable)


def read(path: Path, kind: type[T]) -> tuple[T, tuple[str, ...]]:
    """Read a station file and check what needs neither another file nor a device.

    `kind` says which keys it must have. A warning for each key that has no meaning where it stands.

    Raises:
        InputError: names the key, what stands there, what should, and what to do.
    """
    table, warnings = decode(path, kind)
    check_cameras(path, table)
    one_of(path, "encoders.driver", table.encoders.driver, tuple(ENCODER_KEYS))
    if table.pan.follow and table.pan.driver == "fixed":
        expected = "bases that turn are needed to follow"
        raise key_error(path, "pan.follow", "is true with fixed bases", expected)
    check_clock(path, table.clock)
    listed = None if table.tolerance is None else table.tolerance.joints_deg
    # how many joints the robot has is checked later
    tolerance(path, table.tolerance, len(listed) if isinstance(listed, list) else 1)
    _check_alarm(path, table)
    _check_recording(path, table)
    return table, (*warnings, *_unused_setting_warnings(path, table))


def template() -> str:
    """Give a station file that explains every key, and runs as it is: its devices are simulated."""
    return (resources.files("verify.live.station") / "station.toml").read_text(encoding="utf-8")


def check_cameras(path: Path, table: StationTable) -> None:
    """Raise InputError for a wrong key of [left], [right], [pan].driver or [sim]."""
    for side in ("left", "right"):
        _check_camera(path, side, getattr(table, side))
    _check_sources(path, table)
    one_of(path, "pan.driver", table.pan.driver, tuple(PAN_KEYS))
    _check_sim(path, table)


def _check_camera(path: Path, side: str, table: StationCameraTable) -> None:
    if table.source == "":
        raise key_error(path, f"{side}.source", "is empty", "an index, a device, a URL or a file")
    if table.format is not None and not re.fullmatch(r"[ -~]{4}", table.format):
        expected = "four letters are expected, such as MJPG or YUYV"
        raise key_error(path, f"{side}.format", f'is "{table.format}"', expected)


def _check_sources(path: Path, table: StationTable) -> None:
    """Refuse one camera for both sides, and half a simulation."""
    left, right = table.left.source, table.right.source
    simulated = (left == SIM, right == SIM)
    if any(simulated) and not all(simulated):
        key = "right.source" if simulated[0] else "left.source"
        raise key_error(path, key, 'is not "sim"', "both cameras are simulated, or neither")
    if left == right and not any(simulated):
        expected = "each side has its own camera"
        raise key_error(path, "right.source", "is the left camera's", expected)
    for key in ("rig", "marker"):
        if getattr(table, key) == SIM and not any(simulated):
            expected = 'that goes with cameras whose source is "sim" alone'
            raise key_error(path, key, 'is "sim"', expected, f"Name a {key}.toml.")
    if table.pan.driver == SIM and not any(simulated):
        expected = "bases are simulated with their cameras, or not at all"
        raise key_error(path, "pan.driver", 'is "sim"', expected)


def _check_alarm(path: Path, table: StationTable) -> None:
    alarm = table.alarm
    if alarm.false_alarms_per_hour <= 0:
        found = f"is {alarm.false_alarms_per_hour}"
        expected = "a number above 0 is expected: every test has false alarms"
        raise key_error(path, "alarm.false_alarms_per_hour", found, expected)
    if alarm.mqtt is not None and not re.fullmatch(_MQTT, alarm.mqtt):
        expected = "mqtt://HOST:PORT/TOPIC is expected"
        raise key_error(path, "alarm.mqtt", f'is "{alarm.mqtt}"', expected)
    if alarm.prometheus is not None and not re.fullmatch(HOST_AND_PORT, alarm.prometheus):
        expected = "HOST:PORT is expected, such as 127.0.0.1:9105, a port to 65535"
        raise key_error(path, "alarm.prometheus", f'is "{alarm.prometheus}"', expected)


def _check_recording(path: Path, table: StationTable) -> None:
    name = table.recording.name
    try:
        example = datetime(2026, 1, 15).strftime(name.replace("{robot}", "robot"))
    except ValueError:
        example = ""
    if not example.strip() or re.search(r'[/\\<>:"|?*\0]', example) or example.startswith("."):
        expected = "a folder's name is expected, with {robot} and the marks of strftime"
        raise key_error(path, "recording.name", f'is "{name}"', expected)


def _check_sim(path: Path, table: StationTable) -> None:
    rate = table.encoders.rate_hz
    if table.encoders.driver == SIM and rate is not None and rate <= 0:
        raise key_error(path, "encoders.rate_hz", f"is {rate}", "a number above 0 is expected")
    for index, event in enumerate(table.sim.events):
        key = f"sim.event[{index}]"
        one_of(path, f"{key}.what", event.what, EVENT_KINDS)
        one_of(path, f"{key}.camera", event.camera, (*SIDES, "both"))


def _unused_setting_warnings(path: Path, table: StationTable) -> list[str]:
    """Warn of settings that the chosen driver has not."""
    warnings = []
    for name, keys in (("encoders", ENCODER_KEYS), ("pan", PAN_KEYS)):
        part = getattr(table, name)
        for key in sorted(set(msgspec.to_builtins(part)) - set(keys[part.driver])):
            hint = did_you_mean(key, keys[part.driver])
            note = f'the driver "{part.driver}" has no such setting; it is ignored.{hint}'
            warnings.append(one_line(f"{path}, {name}.{key}: {note}"))
    return warnings
