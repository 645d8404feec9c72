"""Listeners of a run: JSON lines, plain lines, an alarm command, MQTT; none can delay the loop.

Each has a thread of its own. Rows that it is too slow for are left out; alarms never are.
"""

import json
import os
import shlex
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from verify.core.records import Array
from verify.errors import InputError
from verify.live.joint_row import JointRow
from verify.live.protocols import Alarm, Listener

MAX_QUEUED_ROWS = 600  # that may wait for a listener: ten seconds, each pair twice
JOIN_TIMEOUT = 2.0  # s that a listener is given to say what is left
COMMAND_TIMEOUT = 60.0  # s, after which a command is ended


class ListenerThread:
    """Hands rows and alarms to a listener in a thread of its own."""

    def __init__(self, listener: Listener, trouble: Callable[[str], None]) -> None:
        self._listener, self._trouble = listener, trouble
        self._wake = threading.Condition()
        self._rows: deque[tuple[JointRow, Array]] = deque(maxlen=MAX_QUEUED_ROWS)
        self._alarms: deque[Alarm] = deque()
        self._closing = self._failed = False
        self._thread = threading.Thread(target=self._post, name="listener", daemon=True)
        self._thread.start()

    def row(self, row: JointRow, statistic: Array) -> None:
        """Put a row in line; the oldest is left out when there are too many."""
        with self._wake:
            self._rows.append((row, statistic))
            self._wake.notify()

    def alarm(self, alarm: Alarm) -> None:
        """Put an alarm in line, before the rows."""
        with self._wake:
            self._alarms.append(alarm)
            self._wake.notify()

    def close(self) -> None:
        """Let it say what is left, and end."""
        with self._wake:
            self._closing = True
            self._wake.notify()
        self._thread.join(JOIN_TIMEOUT)

    def _post(self) -> None:
        while (item := self._next()) is not None:
            try:
                if isinstance(item, Alarm):
                    self._listener.alarm(item)
                else:
                    self._listener.row(*item)
            except Exception as error:  # whoever is told must not end what tells
                if not self._failed:
                    self._failed = True
                    self._trouble(f"{type(self._listener).__name__}: {error}")
        self._listener.close()

    def _next(self) -> Alarm | tuple[JointRow, Array] | None:
        with self._wake:
            self._wake.wait_for(lambda: self._alarms or self._rows or self._closing)
            queue = self._alarms or self._rows
            return queue.popleft() if queue else None


def row_fields(row: JointRow) -> dict[str, Any]:
    """Units at the door: what a JSON line says of a pair."""
    clock = row.clock
    return {
        "type": "pair",
        "frame": row.frame,
        "t_s": row.t,
        "status": row.status,
        "leds_seen": row.leds_seen,
        "settled": row.settled,
        "measured_deg": _degrees(row.measured),
        "encoder_deg": _degrees(row.encoder),
        "error_deg": _degrees(row.error),
        "error_u_deg": _degrees(row.uncertainty),
        "clock": None
        if clock is None
        else {
            "source": clock.source,
            "encoder_offset_s": clock.offset,
            "standard_uncertainty_s": clock.standard_uncertainty,
            "drift_ppm": clock.drift * 1e6,
            "segment": clock.segment,
        },
    }


class JsonLines(Listener):
    """A line of JSON for each pair and each alarm."""

    def __init__(self, write: Callable[[dict[str, Any]], None]) -> None:
        self._write = write

    def row(self, row: JointRow, statistic: Array) -> None:
        """Write a pair."""
        self._write(row_fields(row) | {"alarm_share": [round(float(s), 4) for s in statistic]})

    def alarm(self, alarm: Alarm) -> None:
        """Write an alarm."""
        self._write({"type": "alarm", **alarm.fields()})


class AlarmCommand(Listener):
    """Calls a command for each alarm that is new, without a shell.

    The facts are in its environment (VERIFY_ALARM_KIND, _JOINT, _TEXT, …) and, as a JSON object, on
    its standard input. One at a time; what lasts longer than a minute is ended.

    Raises:
        InputError: no words, or quotes that do not close.
    """

    def __init__(self, command: str) -> None:
        try:
            self._words = shlex.split(command)
        except ValueError as error:
            found = f"cannot be split into words: {error}"
            raise InputError("--on-alarm", found, "", "Correct it.") from error
        if not self._words:
            raise InputError("--on-alarm", "is empty", "a command is expected", "Name one.")

    def alarm(self, alarm: Alarm) -> None:
        """Call the command.

        Raises:
            OSError: it cannot be run.
            subprocess.TimeoutExpired: it did not come to an end.
        """
        if alarm.revised or alarm.ended is not None:
            return
        fields = alarm.fields()
        facts = {f"VERIFY_ALARM_{k.upper()}": _word(v) for k, v in fields.items() if v is not None}
        subprocess.run(
            self._words,
            input=json.dumps(fields, ensure_ascii=False).encode(),
            env=os.environ | facts,
            stdout=subprocess.DEVNULL,
            stderr=sys.__stderr__,  # which need not be descriptor 2
            timeout=COMMAND_TIMEOUT,
            check=False,
        )


class MqttPublisher:
    """Publishes alarms, and joint errors once a second, at TOPIC/alarm and TOPIC/joints."""

    def __init__(self, client: Any, topic: str) -> None:
        self._client, self._topic = client, topic
        self._published_at = float("-inf")

    def row(self, row: JointRow, statistic: Array) -> None:
        """Publish a row a second."""
        if row.t - self._published_at < 1.0:
            return
        self._published_at = row.t
        text = json.dumps(row_fields(row) | {"alarm_share": statistic.tolist()})
        self._client.publish(f"{self._topic}/joints", text, qos=0, retain=False)

    def alarm(self, alarm: Alarm) -> None:
        """Publish an alarm; the broker keeps the newest for those who come later."""
        text = json.dumps(alarm.fields(), ensure_ascii=False)
        self._client.publish(f"{self._topic}/alarm", text, qos=1, retain=True)

    def close(self) -> None:
        """Take leave of the broker."""
        self._client.disconnect()


def connect_mqtt(url: str) -> MqttPublisher:
    """Connect to a broker, mqtt://HOST[:PORT]/TOPIC; it is looked for again when it is gone.

    Raises:
        InputError: no such address, or paho-mqtt is not installed.
    """
    try:
        parts = urlsplit(url)
        host, port, topic = parts.hostname, parts.port or 1883, parts.path.strip("/")
    except ValueError:  # a port above 65535, or no address in brackets
        host = None
    if host is None or parts.scheme != "mqtt":
        expected = "mqtt://HOST:PORT/TOPIC is expected"
        raise InputError("alarm.mqtt", f'is "{url}"', expected, "Correct it.")
    try:
        from paho.mqtt.client import Client as PahoClient
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        remedy = "Install it: pip install verify-robot[mqtt]."
        raise InputError("alarm.mqtt", "needs the package paho-mqtt", "", remedy) from None
    client = PahoClient(CallbackAPIVersion.VERSION2)
    if parts.username:
        client.username_pw_set(parts.username, parts.password)
    client.connect_async(host, port)
    client.loop_start()
    return MqttPublisher(client, topic)


def _degrees(angles: Array) -> list[float | None]:
    return [angle if np.isfinite(angle) else None for angle in np.rad2deg(angles).tolist()]


def _word(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


REPORT_PERIOD = 10.0  # s


class PlainTextOutput(Listener):
    """Says alarms as they come, and the joint errors every ten seconds."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._due = float("-inf")

    def row(self, row: JointRow, statistic: Array) -> None:
        """Say one row in a while; `statistic` is for those who draw."""
        del statistic
        if row.t < self._due:
            return
        self._due = row.t + REPORT_PERIOD
        if row.status != "measured":
            self._say(f"pair {row.frame}: {row.status.replace('_', ' ')}")
            return
        errors = " ".join(
            f"{e:+.3f}" if np.isfinite(e) else "–" for e in np.rad2deg(row.error).tolist()
        )
        clock = "" if row.clock is None else f"; clock {row.clock.words()}"
        self._say(f"pair {row.frame}: joint errors {errors} deg{clock}")

    def alarm(self, alarm: Alarm) -> None:
        """Say an alarm, also when it is over."""
        over = "" if alarm.ended is None else " Over."
        self._say(f"ALARM {alarm.number}: {alarm.text}{over}")
