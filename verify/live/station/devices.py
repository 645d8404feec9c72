"""From a station file's tables to the drivers of its devices."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from verify.devices.cameras.capture import is_file, open_camera
from verify.devices.encoders.csv import CsvEncoders, CsvSettings
from verify.devices.encoders.intake import AngleMap
from verify.devices.encoders.labenc.reader import LabencEncoders, LabencSettings
from verify.devices.encoders.text import FieldMap, TextEncoders, TextSettings
from verify.devices.melfa.reader import DEFAULT_MELFA_LINE, MelfaEncoders, MelfaSettings
from verify.devices.melfa.realtime import RealtimeEncoders, RealtimeSettings
from verify.devices.pan import PanReader, PanServo
from verify.devices.ports import DEFAULT_LINE, SerialLine, check_port
from verify.devices.protocols import CameraDevice, CameraSettings, EncoderDevice, PanDevice
from verify.errors import InputError
from verify.io.toml import key_error, one_of
from verify.live.station.keys import (
    SECURITY_KEYS,
    AngleDeviceTable,
    PanTable,
    SimulatedDevices,
    SimulatedHardware,
    StationCameraTable,
    StationEncodersTable,
)

COMMON_KEYS = ("driver", "resolution_deg", "time_standard_uncertainty_s")
ANGLE_KEYS = ("sign", "offset_deg")
READ_KEYS = (*COMMON_KEYS, *ANGLE_KEYS)  # of all that are not simulated
SERIAL_KEYS = ("port", "baud", "data_bits", "parity", "stop_bits", "rts_cts")
FIELD_KEYS = (
    *("columns", "separator", "pattern", "skip", "time_unit", "tick_rate_hz", "wraps_after"),
    *("angle_unit", "counts_per_degree", "checksum"),
)
BOARD_KEYS = ("checksum", "rate_hz", "unit", "latch_span_us")
STAMP_KEYS = ("stamp", "cycle_ms", "latency_ms")
ENCODER_KEYS: dict[str, tuple[str, ...]] = {
    "melfa": (*READ_KEYS, *SERIAL_KEYS, "terminator", "pause_ms", "timeout_s", "robot_type"),
    "melfa-realtime": (*READ_KEYS, "port", "cycle_ms"),
    "labenc": (*READ_KEYS, *SERIAL_KEYS, *BOARD_KEYS),
    "text": (*READ_KEYS, *SERIAL_KEYS, *FIELD_KEYS, "latency_ms", "at_start", "at_end"),
    "csv": (*READ_KEYS, "path", *FIELD_KEYS, "latency_ms"),
    "rtde": (*READ_KEYS, "port", "rate_hz"),
    "rosbridge": (*READ_KEYS, "port", "topic", "joint_names", *STAMP_KEYS),
    "opcua": (
        *(*READ_KEYS, "port", "nodes", "angle_unit", "rate_hz"),
        *(*STAMP_KEYS, *SECURITY_KEYS, "user"),
    ),
    "sim": (*COMMON_KEYS, "rate_hz"),
}
PAN_KEYS: dict[str, tuple[str, ...]] = {
    "fixed": ("driver",),
    "serial": ("driver", "follow", *ANGLE_KEYS, "port", "baud", *BOARD_KEYS),
    "sim": ("driver", "follow"),
}
TERMINATORS = {"CR": b"\r", "CR LF": b"\r\n", "NUL": b"\0", "none": b""}
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "hz": 1.0}  # that keys end with, in s and Hz
MELFA_RESOLUTION_DEG = 0.01  # JPOSF prints two decimals


def resolution_deg(table: StationEncodersTable) -> float | None:
    """Say to what the readings are rounded: as stated, else as the driver knows."""
    if table.resolution_deg is None and table.driver == "melfa":
        return MELFA_RESOLUTION_DEG
    return table.resolution_deg


def camera_settings(
    path: Path, table: StationCameraTable, size: tuple[int, int] | None
) -> CameraSettings:
    """Turn [left] or [right] into a camera's settings; `size` (px) where the table has none."""
    source = table.source
    if is_file(source) and source != "sim":
        source = str(path.parent / str(source))
    return CameraSettings(
        source=source,
        size=table.size or size,
        rate=table.rate_hz,
        format=table.format,
        exposure=None if table.exposure_ms is None else table.exposure_ms * 1e-3,
        gain=table.gain,
        white_balance=table.white_balance_k,
        grey=table.grey,
        delay=table.delay_ms * 1e-3,
    )


def open_encoders(
    path: Path, table: StationEncodersTable, joints: int, sim: SimulatedHardware | None
) -> EncoderDevice:
    """Open the encoders that [encoders] names; InputError: a key is wrong."""
    if sim is not None and table.driver == "sim":
        return sim.encoders(table.rate_hz)
    angles = angle_map(path, "encoders", table, joints)
    try:
        return _make_encoders(path, table, angles)
    except InputError as error:
        if error.place.startswith(str(path)):
            raise
        raise InputError(
            f"{path}, {error.place}", error.found, error.expected, error.remedy
        ) from error


def open_cameras(
    left: CameraSettings, right: CameraSettings, sim: SimulatedDevices | None
) -> tuple[CameraDevice, CameraDevice]:
    """Open both cameras, the simulated ones where their source is "sim"."""
    if sim is not None and left.source == "sim":
        return sim.camera(0, left), sim.camera(1, right)
    opened = open_camera(left)
    try:
        return opened, open_camera(right)
    except InputError:
        opened.close()
        raise


def open_pan(path: Path, table: PanTable, sim: SimulatedDevices | None) -> PanDevice | None:
    """Open the bases of [pan], free to turn if they follow; InputError: a key is wrong."""
    if table.driver == "fixed":
        return None
    if sim is not None and table.driver == "sim":
        return sim.pan()
    line = replace(DEFAULT_LINE, baud=table.baud or DEFAULT_LINE.baud)
    settings = _board_settings(path, "pan", table, line)
    angles = angle_map(path, "pan", table, 2)
    return PanServo(settings, angles) if table.follow else PanReader(settings, angles)


def check_pan(path: Path, table: PanTable) -> None:
    """Raise InputError for wrong keys of [pan] before the run: a driver opens its port later."""
    if table.driver != "sim" and (pan := open_pan(path, table, None)) is not None:
        pan.close()


def _make_encoders(path: Path, table: StationEncodersTable, angles: AngleMap) -> EncoderDevice:
    match table.driver:
        case "melfa":
            return MelfaEncoders(melfa_settings(path, table), angles)
        case "melfa-realtime":
            port = _require_port(path, "encoders", table.port)
            if not port.startswith("udp:"):
                expected = "the stream is UDP: udp:HOST:PORT is expected"
                raise key_error(path, "encoders.port", f'is "{port}"', expected)
            return RealtimeEncoders(RealtimeSettings(port, **stated(table, "cycle_ms")), angles)
        case "labenc":
            return LabencEncoders(
                _board_settings(path, "encoders", table, _serial_line(path, table, DEFAULT_LINE)),
                angles,
            )
        case "csv":
            return CsvEncoders(_csv_settings(path, table, angles.joints), angles)
        case "rtde" | "rosbridge" | "opcua":
            from verify.live.station.networked import OPENERS  # slow to load

            return OPENERS[table.driver](path, table, angles)
    return TextEncoders(_text_settings(path, table, angles.joints), angles)


def angle_map(path: Path, name: str, table: AngleDeviceTable, joints: int) -> AngleMap:
    """Sign and zero of each joint; the device's own where nothing is said."""
    given: list[list[float]] = []
    for key, usual in (("sign", 1.0), ("offset_deg", 0.0)):
        values = getattr(table, key)
        if values is not None and len(values) != joints:
            expected = f"one for each of the {joints} joints is expected"
            raise key_error(path, f"{name}.{key}", f"is a list of {len(values)}", expected)
        given.append(values or [usual] * joints)
    if any(sign not in (1, -1) for sign in given[0]):
        raise key_error(path, f"{name}.sign", f"is {given[0]}", "1 or -1 for each is expected")
    return AngleMap(np.array(given[0], dtype=float), np.deg2rad(np.array(given[1], dtype=float)))


def stated(table: AngleDeviceTable, *keys: str) -> dict[str, Any]:
    """Give what a table states of these keys; a time in s, a rate in Hz, by its name alone."""
    given: dict[str, Any] = {}
    for key in keys:
        if (value := getattr(table, key)) is not None:
            name, _, unit = key.rpartition("_")
            given |= {name: value * UNITS[unit]} if unit in UNITS else {key: value}
    return given


def _require_port(path: Path, name: str, port: str | None, line: SerialLine = DEFAULT_LINE) -> str:
    if not port:
        expected = "where the device is reached is needed"
        remedy = 'Example: port = "tcp:192.168.0.20:10001", or a serial device\'s path.'
        raise key_error(path, f"{name}.port", "is missing", expected, remedy)
    try:
        check_port(port, line)
    except InputError as error:
        raise key_error(path, f"{name}.port", error.found, error.expected, error.remedy) from error
    return port


def _serial_line(path: Path, table: StationEncodersTable, usual: SerialLine) -> SerialLine:
    allowed = {"data_bits": (5, 6, 7, 8), "parity": ("N", "E", "O"), "stop_bits": (1, 2)}
    for key, options in allowed.items():
        value = getattr(table, key)
        if value is not None and value not in options:
            expected = f"one of {', '.join(map(str, options))} is expected"
            raise key_error(path, f"encoders.{key}", f"is {value}", expected)
    return replace(usual, **stated(table, "baud", *allowed, "rts_cts"))


def melfa_settings(path: Path, table: StationEncodersTable) -> MelfaSettings:
    """Settings of a MELFA controller; InputError: a key is wrong."""
    given = stated(table, "pause_ms", "timeout_s")
    if table.terminator is not None:
        one_of(path, "encoders.terminator", table.terminator, tuple(TERMINATORS))
        given["terminator"] = TERMINATORS[table.terminator]
    line = _serial_line(path, table, DEFAULT_MELFA_LINE)
    return MelfaSettings(
        _require_port(path, "encoders", table.port, line),
        line,
        robot_type=table.robot_type,
        **given,
    )


def _board_settings(
    path: Path, name: str, table: AngleDeviceTable, line: SerialLine
) -> LabencSettings:
    if table.checksum is not None:
        one_of(path, f"{name}.checksum", table.checksum, ("xor", "crc16"))
    if table.unit is not None:
        one_of(path, f"{name}.unit", table.unit, ("deg", "counts"))
    rate = table.rate_hz
    if rate is not None and (rate < 1 or rate != int(rate)):
        raise key_error(path, f"{name}.rate_hz", f"is {rate:g}", "a whole number is expected")
    return LabencSettings(
        _require_port(path, name, table.port, line),
        line,
        table.checksum or "xor",
        None if rate is None else int(rate),
        table.unit,
        **stated(table, "latch_span_us"),
    )


def _field_map(table: StationEncodersTable, joints: int) -> FieldMap:
    given = stated(table, *FIELD_KEYS)
    lists = {key: tuple(value) for key, value in given.items() if isinstance(value, list)}
    return FieldMap(joints, **given | lists)


def _csv_settings(path: Path, table: StationEncodersTable, joints: int) -> CsvSettings:
    if not table.path:
        raise key_error(path, "encoders.path", "is missing", "which file is followed is needed")
    fields = _field_map(table, joints) if (table.columns or table.pattern) else None
    return CsvSettings(path.parent / table.path, fields, **stated(table, "latency_ms"))


def _text_settings(path: Path, table: StationEncodersTable, joints: int) -> TextSettings:
    words = {key: text.encode() for key, text in stated(table, "at_start", "at_end").items()}
    given = stated(table, "latency_ms") | words
    line = _serial_line(path, table, DEFAULT_LINE)
    return TextSettings(
        _require_port(path, "encoders", table.port, line), _field_map(table, joints), line, **given
    )
