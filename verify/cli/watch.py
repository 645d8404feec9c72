"""`verify run` on a station: open its devices, watch, report, record."""

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from rich.console import Console, RenderableType

from verify.analysis.clock.estimate import ClockEstimate
from verify.cli.options import PageOptions
from verify.cli.terminal import hangups, terminal
from verify.core.processes import ChildLostError, ChildProcess, answer_requests
from verify.errors import InputError, WatchDefectError
from verify.io.files import refused_as_input_error
from verify.io.series import ALARM_COLUMNS
from verify.io.session.keys import Tolerance
from verify.live.alarms.joints import AlarmLimits
from verify.live.clock import ESTIMATE_TIMEOUT, ClockRequest, estimate_offset
from verify.live.loop import LiveLoop, LoopComputation
from verify.live.measuring_process import MeasuringProcess
from verify.live.outputs import listeners as outputs
from verify.live.outputs.metrics import MetricsServer
from verify.live.outputs.terminal import TerminalDisplay, render_snapshot
from verify.live.page.run import RunFacts, RunPageSource
from verify.live.protocols import Alarm, Listener, LiveDevices
from verify.live.recording.recorder import RecorderState
from verify.live.state import DeviceStatus, LiveState
from verify.live.station.station import PanDrive, RecordingStation, Station

if TYPE_CHECKING:  # imported when it is served
    from verify.live.page.feed import Page

# s that a thread may keep the others waiting; Python's own 5 ms are half a pair's
SWITCH_INTERVAL = 0.0005


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run on a station."""

    duration: float | None  # s
    tolerance: Tolerance  # replaces the station's, entry by entry
    on_alarm: str | None
    page: PageOptions | None


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run recorded."""

    folders: tuple[Path, ...]  # sessions: more than one where the controller's clock began anew
    alarms: tuple[Alarm, ...]  # oldest first; of very many the newest
    defects: tuple[str, ...]  # why it could not go on
    warnings: tuple[str, ...]  # what the recordings do not show


def watch(station: Station, options: RunOptions) -> RunResult:
    """Watch until Ctrl-C, the time is up, or the robot's program ends.

    Raises:
        InputError: a device, the page or a listener cannot be opened; nothing is running then.
        WatchDefectError: it could not begin, or not go on before anything was recorded.
    """
    require_recordable(station.recording.folder, f"{station.path}, recording.folder")
    joints = options.tolerance.joints
    if joints is None and station.tolerance is not None:
        joints = station.tolerance.joints
    limits = AlarmLimits(station.alarm.false_alarms_per_hour, station.rate, joints)
    state = LiveState()
    facts = RunFacts(station.robot, station.name, limits, options.duration)
    with ExitStack() as stack:
        stack.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(SWITCH_INTERVAL)
        listeners = _listeners(station, options, stack)
        source = RunPageSource(state, station.watched, facts)
        page = None
        if options.page is not None:
            page = options.page.serve(source, moment=state.wait_for_pair)
            stack.callback(page.close)
        if station.alarm.prometheus is not None:
            stack.callback(MetricsServer(station.alarm.prometheus, source.metrics).close)
        clock: ChildProcess[ClockRequest, ClockEstimate] = ChildProcess(
            answer_requests, estimate_offset, name="clock", background=True
        )
        stack.callback(clock.stop)
        try:
            chain = MeasuringProcess(station.rig, station.watched.marker, terminal.warn)
        except ChildLostError as error:
            why = f"The measuring process does not start: {error}. Nothing was watched or recorded."
            raise WatchDefectError(why) from error
        stack.callback(chain.close)
        recorder = station.open_recorder()
        stack.callback(recorder.close)
        computation = LoopComputation(
            lambda request: clock.ask(request, ESTIMATE_TIMEOUT), chain.measure, chain.prepare
        )
        devices = open_devices(station)
        if station.follow and isinstance(devices.pan, PanDrive):
            devices = replace(devices, turn=devices.pan.turn_to)
        live = LiveLoop(
            station.watched,
            devices,
            recorder,
            limits,
            options.duration,
            computation,
            listeners,
            state,
        )
        stack.enter_context(_frozen_garbage_collector())
        degrees = None if joints is None else np.rad2deg(joints).tolist()
        look = stack.enter_context(
            show_state(lambda: render_snapshot(state.snapshot(), degrees), page)
        )
        live.run(stack.enter_context(stop_on_signal()), lambda _: look())
    _print_summary(state)
    recorded = recorder.state()
    terminal.say(recorded.sentence)
    if not recorded.folders and live.defects:
        raise WatchDefectError(" ".join(live.defects))
    now = state.snapshot()
    require_recorded(station, recorded, now.devices)
    missing = now.pairs - recorded.pairs - recorded.dropped  # the disk was full or too slow
    told = f"{missing} of {now.pairs} watched pairs were not recorded and are not in the report."
    warnings = (told,) if missing > 0 else ()
    return RunResult(recorded.folders, now.alarms[::-1], live.defects, warnings)


def require_recorded(
    station: RecordingStation, recorded: RecorderState, devices: Iterable[DeviceStatus]
) -> None:
    """Refuse a recording without a pair or reading; the InputError says which device is silent."""
    silent = "; ".join(f"{line.name}: {line.sentence}" for line in devices if not line.well)
    told = f" ({why})" if (why := recorded.trouble or silent) else ""
    if not recorded.folders:
        raise InputError(
            station.path, f"no pair of pictures was recorded{told}",
            "two working cameras and free disk space are needed",
            "Try `verify doctor` on this file.",
        )  # fmt: skip
    if not recorded.readings:
        raise InputError(
            recorded.folders[0], f"{recorded.pairs} pairs and no reading{told}",
            "the robot's readings are needed with the pictures",
            "Try `verify doctor` on the station file, then record again.",
        )  # fmt: skip


def alarms_table(alarms: tuple[Alarm, ...]) -> pd.DataFrame:
    """Lay alarms out as alarms.csv has them, one a row."""
    rows = [alarm.fields() for alarm in alarms]
    for row in rows:
        row["not_told_apart_from"] = "+".join(map(str, row["not_told_apart_from"]))
        for key in ("began", "ended"):
            t = row.pop(f"{key}_s")
            time = None if t is None else datetime.fromtimestamp(t, UTC)
            row[f"{key}_utc"] = time and time.isoformat(timespec="milliseconds")
        del row["revised"]
    return pd.DataFrame(rows, columns=list(ALARM_COLUMNS)).astype({"joint": "Int64"})


def require_recordable(folder: Path, place: Path | str) -> None:
    """Refuse, before anything runs, a folder that cannot be made; the InputError names `place`."""
    with refused_as_input_error(folder):
        above = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        expected, remedy = "a folder that takes files is expected", "Choose another one."
        raise InputError(place, f"cannot be made in {above}", expected, remedy)


def open_devices(station: RecordingStation) -> LiveDevices:
    """Open all devices, to be read; none stays open if one cannot be."""
    with ExitStack() as opened:
        left, right = station.open_cameras()
        opened.callback(left.close)
        opened.callback(right.close)
        encoders = station.open_encoders()
        opened.callback(encoders.close)
        pan = station.open_pan()
        opened.pop_all()
    return LiveDevices(left, right, encoders, pan, files=station.files)


def _listeners(station: Station, options: RunOptions, stack: ExitStack) -> list[Listener]:
    """Listeners to pairs and alarms; the stack closes them."""
    listeners: list[Listener] = []

    def add(listener: Listener) -> None:
        listeners.append(outputs.ListenerThread(listener, terminal.warn))
        stack.callback(listeners[-1].close)

    command = options.on_alarm if options.on_alarm is not None else station.alarm.command
    if command is not None:
        add(outputs.AlarmCommand(command))
    if station.alarm.mqtt is not None:
        add(outputs.connect_mqtt(station.alarm.mqtt))
    if terminal.as_json:
        add(outputs.JsonLines(lambda fields: terminal.record(fields.pop("type"), **fields)))
    elif not terminal.draws:
        add(outputs.PlainTextOutput(terminal.say))
    return listeners


@contextmanager
def _frozen_garbage_collector() -> Iterator[None]:
    """Exclude existing objects from garbage collection, which stops all threads."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def show_state(
    render: Callable[[], RenderableType],
    page: "Page | None" = None,
    otherwise: Callable[[], None] = lambda: None,
) -> Iterator[Callable[[], None]]:
    """Show `render` where there is a terminal, do `otherwise` elsewhere; with each call once.

    Warns once of a page that is gone.
    """
    warned = False
    with TerminalDisplay(Console(), render) if terminal.draws else nullcontext() as table:

        def look() -> None:
            nonlocal warned
            if table is not None:
                table.draw()
            else:
                otherwise()
            if page is not None and page.trouble and not warned:
                warned = True
                terminal.warn(page.trouble)

        yield look


@contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """Set an event at Ctrl-C, SIGTERM or when the terminal closes: the run ends with its report.

    A second signal interrupts, but that of the terminal: a shell passes it on, so it comes twice.
    """
    stop, closed = threading.Event(), hangups()

    def first(number: int, _frame: FrameType | None) -> None:
        stop.set()
        if number not in closed:
            signal.signal(number, before[signal.Signals(number)])

    before = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, *closed)}
    for number in before:
        signal.signal(number, first)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print_summary(state: LiveState) -> None:
    now = state.snapshot()
    p50, p99 = state.latency.of_all() or (None, None)
    terminal.record(
        "watched",
        pairs=now.pairs,
        statuses=state.statuses(),
        dropped=dict(now.dropped),
        alarms=dict(now.alarm_counts),
        latency_p50_ms=None if p50 is None else p50 * 1e3,
        latency_p99_ms=None if p99 is None else p99 * 1e3,
        recording=now.recording,
    )
    lost = ", ".join(f"{why} ({n})" for why, n in now.dropped.items()) or "none"
    alarms = ", ".join(f"{n} {kind}" for kind, n in now.alarm_counts.items()) or "none"
    terminal.say(f"{now.measured} of {now.pairs} pairs measured; lost: {lost}; alarms: {alarms}")
    for line in now.devices:
        if not line.well:
            terminal.warn(f"{line.name}: {line.sentence}")
