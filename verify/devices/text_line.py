"""Encoders that print a text line of any kind, on a serial port or TCP, read by a field map."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from verify.devices.field_map import FieldMap
from verify.devices.intake import AngleMap, Counts
from verify.devices.lines import LineBuffer
from verify.devices.link import Link, Now
from verify.devices.ports import USUAL_LINE, Port, SerialLine, open_port
from verify.devices.protocols import DeviceState, EncoderReading
from verify.devices.text_intake import TextIntake

USB_LATENCY = 0.016  # s: a USB-serial bridge collects bytes for up to so long


@dataclass(frozen=True, slots=True)
class TextSettings:
    """How the device is reached, and what it is told."""

    port: str
    fields: FieldMap
    line: SerialLine = USUAL_LINE
    latency: float = USB_LATENCY  # s
    at_start: bytes = b""  # sent when the line is open: starts the stream
    at_end: bytes = b""  # sent before it is closed


class TextEncoders:
    """Joint readings from lines of text.

    Args:
        settings: how the device is reached, and its field map.
        angles: from the device's angles to the robot file's own.
        port: opens the port instead of the settings' address.
        now: the host's monotonic clock, s.
    """

    def __init__(
        self,
        settings: TextSettings,
        angles: AngleMap,
        port: Callable[[], Port] | None = None,
        now: Now = time.monotonic,
    ) -> None:
        opens = port or partial(open_port, settings.port, settings.line)
        self._settings = settings
        self._link = Link(settings.port, opens, now)
        self._lines = LineBuffer()
        self._counts = Counts()
        self._intake = TextIntake(settings.fields, angles, settings.latency, self._counts)
        self._connection = 0

    def read(self) -> list[EncoderReading]:
        """Give what has arrived since the last call, oldest first; waits for at most 20 ms."""
        chunk = self._link.receive()
        if self._link.connections != self._connection:
            self._connection = self._link.connections
            self._lines.clear()
            self._intake.restart()
            if self._settings.at_start:
                self._link.send(self._settings.at_start)
        if chunk is None:
            return []
        readings = []
        for line in self._lines.feed(chunk.data):
            readings += self._intake.take(line, chunk)
        if readings:
            self._link.steady()
        return readings

    def state(self) -> DeviceState:
        """Say how the device is."""
        return self._counts.state(self._link)

    def close(self) -> None:
        """Send what ends the stream, if anything, and close the port."""
        if self._settings.at_end:
            self._link.send(self._settings.at_end)
        self._link.close()
