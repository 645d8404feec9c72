import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.devices.bench import Ramp, for_seconds, gather, kept, running, same_angles
from verify.devices.encoders.text import FieldMap, LineFields, TextEncoders, TextSettings
from verify.devices.ports import CHECKSUMS
from verify.errors import InputError
from verify.simulation.emulators.server import EmulatorFaults, TimedMessage

NAMES = ("t", "q1", "q2", "q3", "q4", "q5", "q6")
ANGLES = {1: -7.42, 2: 38.21, 3: 77.74, 4: 7.08, 5: 61.72, 6: -9.75}
LINE = "12.5,-7.42,38.21,77.74,7.08,61.72,-9.75"
AR4 = "".join(rf"{letter}(?P<q{j}>[-.\d]+)" for j, letter in enumerate("ABCDEF", start=1)) + "$"
TELEPLOT = r"^>q(?P<axis>\d):(?P<t>\d+):(?P<value>[-.\d]+)$"  # one axis a line
NMEA = r"^\$(?P<q1>[-.\d]+),(?P<q2>[-.\d]+)\*(?P<sum>..)$"
GRBL = r"^<(Idle|Run)\|MPos:" + ",".join(rf"(?P<q{j}>[-.\d]+)" for j in range(1, 7)) + r"[|>]"


def read(fields: FieldMap, line: str) -> LineFields:
    found = fields.parse(line.encode())
    assert isinstance(found, LineFields), found
    return found


def test_time_and_six_angles() -> None:
    fields = FieldMap(6, NAMES, time_unit="s")
    assert read(fields, LINE) == LineFields(12.5, None, ANGLES)
    short = LINE.rpartition(",")[0].encode()
    assert fields.parse(short) == "line that does not fit the field map"
    for wrong in ("77.7x", "", "nan"):
        assert fields.parse(LINE.replace("77.74", wrong).encode()) == "field that is not a number"


@pytest.mark.parametrize("kind", CHECKSUMS)
def test_a_trailing_sum(kind: str) -> None:
    fields = FieldMap(6, (*NAMES, "sum"), time_unit="s", checksum=kind)
    total = f"{CHECKSUMS[kind][1](LINE.encode()):X}"
    assert read(fields, f"{LINE},{total}").values == ANGLES
    assert fields.parse(f"{LINE.replace('38', '39')},{total}".encode()) == "wrong checksum"
    assert fields.parse(f"{LINE},".encode()) == "wrong checksum"


@pytest.mark.parametrize(
    ("fields", "line", "expected", "other", "words"),
    [
        (
            FieldMap(6, pattern=GRBL, skip=r"^(ok|\[|Grbl)"),
            "<Idle|MPos:-7.42,38.21,77.74,7.08,61.72,-9.75|FS:0,0>",
            LineFields(None, None, ANGLES), "ok", "",
        ),
        (
            FieldMap(6, pattern=AR4), "A-7.42B38.21C77.74D7.08E61.72F-9.75",
            LineFields(None, None, ANGLES), "A-7.42B38", "line that does not fit the field map",
        ),
        (
            FieldMap(6, pattern=TELEPLOT, time_unit="ms"), ">q3:1627551892437:77.74",
            LineFields(1627551892437.0, None, {3: 77.74}),
            ">q7:1:2.0", "axis that the robot does not have",
        ),
        (
            FieldMap(2, pattern=NMEA, checksum="xor"),
            f"$1.5,-2.5*{CHECKSUMS['xor'][1](b'1.5,-2.5'):02X}",
            LineFields(None, None, {1: 1.5, 2: -2.5}), "$1.5,-2.5*00", "wrong checksum",
        ),
    ],
    ids=["grbl", "ar4", "teleplot", "nmea"],
)  # fmt: skip
def test_lines_of_usual_programs_by_a_pattern(
    fields: FieldMap, line: str, expected: LineFields, other: str, words: str
) -> None:
    assert read(fields, line) == expected
    assert fields.parse(other.encode()) == words


def test_units() -> None:
    counts = FieldMap(2, ("q1", "q2"), angle_unit="counts", counts_per_degree=(100.0, -200.0))
    np.testing.assert_allclose(counts.radians_per_unit, np.deg2rad([0.01, -0.005]))
    ticks = FieldMap(1, ("t", "q1"), time_unit="ticks", tick_rate=250.0, wraps_after=65536)
    assert ticks.seconds_per_unit == 0.004
    assert ticks.wrap == pytest.approx(262.144)
    assert FieldMap(1, ("q1",), angle_unit="rad").radians_per_unit[0] == 1.0
    assert FieldMap(1, ("q1",)).radians_per_unit[0] == math.radians(1)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"columns": ("t", "q1")}, "name no q2"),
        ({"columns": ("q1", "q2"), "time_unit": "ms"}, "name no t"),
        ({"columns": ("q1", "q2"), "checksum": "xor"}, "name no sum"),
        ({"columns": ("q1", "q2"), "angle_unit": "grad"}, "grad"),
        ({"columns": ("q1", "q2"), "angle_unit": "counts"}, "one number a joint"),
        ({"columns": ("t", "q1", "q2"), "time_unit": "ticks"}, "tick_rate_hz"),
        ({"columns": ("t", "q1", "q2"), "time_unit": "min"}, "min"),
        ({"columns": ("q1", "q2", "sum"), "checksum": "md5"}, "md5"),
        ({"pattern": "(?P<q1>"}, "not a regular expression"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(
    settings: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        FieldMap(2, **settings)  # type: ignore[arg-type]


@given(st.binary(max_size=80))
def test_random_bytes_never_raise(data: bytes) -> None:
    for fields in (FieldMap(6, NAMES, time_unit="s"), FieldMap(6, pattern=GRBL)):
        found = fields.parse(data)
        if isinstance(found, LineFields):
            assert all(map(math.isfinite, found.values.values()))


class Printer:
    """A board that prints a line every 20 ms once it was told to, each by a format."""

    def __init__(self, timed: bool = True) -> None:
        self.log: list[bytes] = []
        self._next, self._timed = 0.0, timed
        self._on = False

    def greet(self, _t: float) -> None:
        self._on = False

    def reset(self, t: float) -> None: ...

    def afflict(self, fault: str, value: float) -> None: ...

    def step(self, t: float, received: bytes) -> list[TimedMessage]:
        if received:
            self.log.append(received)
            self._on = b"go" in received
        messages = []
        while self._next <= t:
            degrees = [f"{angle:.4f}" for angle in np.rad2deg(Ramp()(self._next))]
            start = [f"{self._next * 1e3:.0f}"] if self._timed else []
            line = ",".join(start + degrees) + "\r\n"
            if self._on:
                messages.append(TimedMessage(self._next, line.encode()))
            self._next += 0.02
        return messages


def driver(address: str, fields: FieldMap) -> TextEncoders:
    settings = TextSettings(address, fields, at_start=b"go\n", at_end=b"halt\n")
    return kept(TextEncoders(settings, same_angles(6)))


@pytest.mark.parametrize("where", ["tcp:0", "pty"])
def test_lines_with_a_time_of_their_own(where: str) -> None:
    board = Printer()
    with running(board, where) as emulated:
        encoders = driver(emulated.address, FieldMap(6, NAMES, time_unit="ms"))
        for reading in gather(encoders, lambda found: len(found) >= 20):
            assert reading.t == pytest.approx(Ramp().time(reading.q), abs=1e-3)
            assert reading.half_width == 0.0005
        encoders.close()
        encoders.close()
    assert board.log[0] == b"go\n"


@pytest.mark.realtime
def test_lines_without_a_time_are_stamped_on_arrival_with_their_latency() -> None:
    with running(Printer(timed=False)) as emulated:
        encoders = driver(emulated.address, FieldMap(6, NAMES[1:]))
        for reading in gather(encoders, lambda found: len(found) >= 20):
            assert reading.half_width >= 0.008
            assert reading.t + reading.half_width == pytest.approx(reading.t_host)
            true = emulated.start + Ramp().time(reading.q)
            assert true <= reading.t_host + 1e-3


@pytest.mark.realtime
def test_a_disturbed_line_gives_no_false_time() -> None:
    faults = EmulatorFaults(noise=0.2, half=0.2, split=0.2, silence=(1.0, 0.5))
    fields = FieldMap(6, (*NAMES,), time_unit="ms")
    with running(Printer(), faults=faults) as emulated:
        encoders = driver(emulated.address, fields)
        readings = gather(encoders, for_seconds(2.5))
        assert len(readings) > 10
        assert np.all(np.diff([reading.t for reading in readings]) > 0)
        assert sum(encoders.state().bad.values()) > 0
        assert "dropped" in encoders.state().sentence


@pytest.mark.realtime
def test_one_axis_a_line_is_joined_by_time() -> None:
    class OneAxis(Printer):
        def step(self, t: float, received: bytes) -> list[TimedMessage]:
            messages = []
            for message in super().step(t, received):
                start, *angles = message.data.decode().strip().split(",")
                for axis, angle in enumerate(angles, start=1):
                    line = f">q{axis}:{start}:{angle}\n"
                    messages.append(TimedMessage(message.at, line.encode()))
            return messages

    fields = FieldMap(6, pattern=TELEPLOT, time_unit="ms")
    with running(OneAxis(), faults=EmulatorFaults(lost=0.02)) as emulated:
        encoders = driver(emulated.address, fields)
        for reading in gather(encoders, lambda found: len(found) >= 50):
            assert reading.t == pytest.approx(Ramp().time(reading.q), abs=1e-3)
        assert encoders.state().bad["instant without all joints"] > 0
