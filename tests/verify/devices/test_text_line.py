import numpy as np
import pytest

from tests.verify.devices.bench import Ramp, for_seconds, gather, kept, running, same_angles
from verify.devices.field_map import FieldMap
from verify.devices.text_line import TextEncoders, TextSettings
from verify.emulators.faults import Faults
from verify.emulators.server import Message

NAMES = ("t", "q1", "q2", "q3", "q4", "q5", "q6")


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

    def step(self, t: float, received: bytes) -> list[Message]:
        if received:
            self.log.append(received)
            self._on = b"go" in received
        messages = []
        while self._next <= t:
            degrees = [f"{angle:.4f}" for angle in np.rad2deg(Ramp().at(self._next))]
            start = [f"{self._next * 1e3:.0f}"] if self._timed else []
            line = ",".join(start + degrees) + "\r\n"
            if self._on:
                messages.append(Message(self._next, line.encode()))
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


def test_lines_without_a_time_are_stamped_on_arrival_with_their_latency_as_doubt() -> None:
    with running(Printer(timed=False)) as emulated:
        encoders = driver(emulated.address, FieldMap(6, NAMES[1:]))
        for reading in gather(encoders, lambda found: len(found) >= 20):
            assert reading.half_width >= 0.008
            assert reading.t + reading.half_width == pytest.approx(reading.t_host)
            true = emulated.start + Ramp().time(reading.q)
            assert true <= reading.t_host + 1e-3


def test_a_disturbed_line_tells_no_false_time() -> None:
    faults = Faults(noise=0.2, half=0.2, split=0.2, silence=(1.0, 0.5))
    fields = FieldMap(6, (*NAMES,), time_unit="ms")
    with running(Printer(), faults=faults) as emulated:
        encoders = driver(emulated.address, fields)
        readings = gather(encoders, for_seconds(2.5))
        assert len(readings) > 10
        assert np.all(np.diff([reading.t for reading in readings]) > 0)
        assert sum(encoders.state().bad.values()) > 0
        assert "dropped" in encoders.state().sentence


def test_one_axis_a_line_is_joined_by_time() -> None:
    class OneAxis(Printer):
        def step(self, t: float, received: bytes) -> list[Message]:
            messages = []
            for message in super().step(t, received):
                start, *angles = message.data.decode().strip().split(",")
                for axis, angle in enumerate(angles, start=1):
                    line = f">q{axis}:{start}:{angle}\n"
                    messages.append(Message(message.at, line.encode()))
            return messages

    fields = FieldMap(6, pattern=r"^>q(?P<axis>\d):(?P<t>\d+):(?P<value>\S+)$", time_unit="ms")
    with running(OneAxis(), faults=Faults(lost=0.02)) as emulated:
        encoders = driver(emulated.address, fields)
        for reading in gather(encoders, lambda found: len(found) >= 50):
            assert reading.t == pytest.approx(Ramp().time(reading.q), abs=1e-3)
        assert encoders.state().bad["instant without all joints"] > 0
