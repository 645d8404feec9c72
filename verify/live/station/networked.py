"""From [encoders] to the drivers of the controllers that are read over a network protocol."""

import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from verify.devices.encoders.intake import AngleMap
from verify.devices.encoders.opcua import POLICIES, OpcUaEncoders, OpcUaSecurity, OpcUaSettings
from verify.devices.encoders.rosbridge import RosbridgeEncoders, RosbridgeSettings
from verify.devices.encoders.rtde import MAX_RTDE_RATE, RTDE_JOINTS, RtdeEncoders, RtdeSettings
from verify.devices.protocols import EncoderDevice
from verify.io.toml import key_error, one_of
from verify.live.station.devices import stated
from verify.live.station.keys import HOST_AND_PORT, SECURITY_KEYS, StationEncodersTable

MAX_POLL_RATE = 200.0  # Hz: a poll of more is slower than its server
RADIANS_PER_UNIT = {"deg": math.radians(1.0), "rad": 1.0}
PASSWORD_VARIABLE = "VERIFY_OPCUA_PASSWORD"
_PORTS = {  # what the address of each driver looks like, and an example
    "rtde": (f"tcp:{HOST_AND_PORT}", "tcp:192.168.0.20:30004"),
    "rosbridge": (rf"wss?://{HOST_AND_PORT}?(/\S*)?", "ws://192.168.0.20:9090"),
    "opcua": (rf"opc\.tcp://([^\s@/]+@)?{HOST_AND_PORT}?(/\S*)?", "opc.tcp://192.168.0.20:4840"),
}


def open_rtde(path: Path, table: StationEncodersTable, angles: AngleMap) -> RtdeEncoders:
    """Open a Universal Robots controller; InputError: a key is wrong."""
    if angles.joints != RTDE_JOINTS:
        found = 'is "rtde"'
        expected = f"it reads {RTDE_JOINTS} joints, and the robot has {angles.joints}"
        raise key_error(path, "encoders.driver", found, expected, "Name the arm that is read.")
    _check_range(path, "rate_hz", table.rate_hz, 1.0, MAX_RTDE_RATE)
    return RtdeEncoders(RtdeSettings(_address(path, table), table.rate_hz), angles)


def open_rosbridge(path: Path, table: StationEncodersTable, angles: AngleMap) -> RosbridgeEncoders:
    """Open a topic behind rosbridge; InputError: a key is wrong."""
    names = _named(path, "joint_names", table.joint_names, angles.joints)
    if len(names) != angles.joints:
        expected = f"the names of the {angles.joints} joints, in the robot file's order"
        raise key_error(path, "encoders.joint_names", f"names {len(names)}", expected)
    given = _stamp_settings(path, table)
    if table.topic is not None:
        if not re.fullmatch(r"/?[A-Za-z_]\w*(/\w+)*", table.topic):
            expected = "the name of a topic is expected, such as /joint_states"
            raise key_error(path, "encoders.topic", f'is "{table.topic}"', expected)
        given["topic"] = table.topic
    return RosbridgeEncoders(RosbridgeSettings(_address(path, table), names, **given), angles)


def open_opcua(path: Path, table: StationEncodersTable, angles: AngleMap) -> OpcUaEncoders:
    """Open an OPC UA server; InputError: a key is wrong, or asyncua is not installed."""
    nodes = _named(path, "nodes", table.nodes, angles.joints)
    if len(nodes) not in (1, angles.joints):
        expected = f"a node for each of the {angles.joints} joints, or one that is an array of all"
        raise key_error(path, "encoders.nodes", f"names {len(nodes)}", expected)
    given = _stamp_settings(path, table)
    if table.angle_unit is not None:
        one_of(path, "encoders.angle_unit", table.angle_unit, tuple(RADIANS_PER_UNIT))
        given["radians_per_unit"] = RADIANS_PER_UNIT[table.angle_unit]
    _check_range(path, "rate_hz", table.rate_hz, 0.5, MAX_POLL_RATE)
    given |= stated(table, "rate_hz")
    url = _address(path, table)
    if table.user is not None:
        given |= {"user": table.user, "password": _password(path, table.user, url)}
    settings = OpcUaSettings(url, nodes, **given, security=_security(path, table))
    return OpcUaEncoders(settings, angles)


OPENERS: dict[str, Callable[[Path, StationEncodersTable, AngleMap], EncoderDevice]] = {
    "rtde": open_rtde,
    "rosbridge": open_rosbridge,
    "opcua": open_opcua,
}


def _security(path: Path, table: StationEncodersTable) -> OpcUaSecurity | None:
    """Read the keys of an encrypted channel; None: there are none."""
    given = stated(table, *SECURITY_KEYS)
    if not given:
        return None
    for key in SECURITY_KEYS[:2]:
        if key not in given:
            expected = "an encrypted channel needs certificate and private_key"
            raise key_error(path, f"encoders.{key}", "is missing", expected)
    policy = given.pop("security_policy", POLICIES[0])
    one_of(path, "encoders.security_policy", policy, POLICIES)
    return OpcUaSecurity(**{key: path.parent / file for key, file in given.items()}, policy=policy)


def _password(path: Path, user: str, url: str) -> str:
    """Take the user's password from the environment: a station file is no place for one."""
    if "@" in url:
        raise key_error(path, "encoders.user", "is given, and port names a user too", "one of both")
    password = os.environ.get(PASSWORD_VARIABLE)
    if password is None:
        found = f'is "{user}", whose password is not in the environment'
        remedy = f"Set it before the command: export {PASSWORD_VARIABLE}=…"
        raise key_error(path, "encoders.user", found, "the server asks for both", remedy)
    return password


def _address(path: Path, table: StationEncodersTable) -> str:
    pattern, example = _PORTS[table.driver]
    port = table.port
    if port is None or not re.fullmatch(pattern, port):
        shown = (port or "").rpartition("@")[2]  # no password
        found = "is missing" if port is None else f'is "{shown}"'
        raise key_error(path, "encoders.port", found, f"an address such as {example} is expected")
    return port


def _named(path: Path, key: str, names: list[str] | None, joints: int) -> tuple[str, ...]:
    if not names:
        expected = f"one for each of the {joints} joints, in the robot file's order, is needed"
        raise key_error(path, f"encoders.{key}", "is missing", expected)
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        found = f'names "{twice[0]}" twice'
        raise key_error(path, f"encoders.{key}", found, "each joint has its own")
    return tuple(names)


def _stamp_settings(path: Path, table: StationEncodersTable) -> dict[str, Any]:
    given: dict[str, Any] = {}
    if table.stamp is not None:
        one_of(path, "encoders.stamp", table.stamp, ("source", "arrival"))
        given["arrival"] = table.stamp == "arrival"
    for key, most in (("cycle_ms", 1e3), ("latency_ms", 1e4)):
        _check_range(path, key, getattr(table, key), 0.0, most)
    return given | stated(table, "cycle_ms", "latency_ms")


def _check_range(path: Path, key: str, value: float | None, least: float, most: float) -> None:
    if value is not None and not least <= value <= most:  # nor what is no number
        expected = f"a number from {least:g} to {most:g} is expected"
        raise key_error(path, f"encoders.{key}", f"is {value:g}", expected)
