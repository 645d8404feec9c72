"""`verify record`: open a station's devices, record, say what the motion still lacks."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from verify.cli import watch
from verify.cli.options import PageOptions
from verify.cli.terminal import terminal
from verify.errors import InputError, WatchDefectError
from verify.io.files import refused_as_input_error
from verify.live.recording.recorder import RecorderState
from verify.live.registration import show
from verify.live.registration.loop import RecordingLoop, warm_up
from verify.live.station.station import RecordingSettings, RecordingStation, open_recording_station
from verify.simulation.devices.station import SimulatedStation

# s that a disk may be behind: nothing else waits for it, and pairs are left out meanwhile
MAX_LAG = 10.0
# s, from one JSON object, and one set of lines, to the next
RECORD_PERIOD, LINES_PERIOD = 1.0, 10.0


def record_session(
    path: Path, out: Path | None, duration: float | None, page: PageOptions | None
) -> None:
    """Record until Ctrl-C, the time is up, or the robot's program ends.

    `out` None: where the station file says; `duration` in s.

    Raises:
        InputError: a device or the page cannot be opened, `out` exists, the disk refuses, or no
            pair or no reading came.
        WatchDefectError: a defect of this program lost pairs or readings.
    """
    station = open_recording_station(path, partial(SimulatedStation, apart=True))
    if out is not None:
        station = replace(station, recording=_settings(out))
        watch.require_recordable(out, out)
    else:
        watch.require_recordable(station.recording.folder, f"{path}, recording.folder")
    terminal.warn(*station.warnings)
    state = show.RecordingState(show.RecordingSnapshot())
    with ExitStack() as stack:
        shown = None
        if page is not None:
            shown = page.serve(
                show.RecordingPageSource(state, station.robot, station.name, duration)
            )
            stack.callback(shown.close)
        warm_up(station.arm)  # before the first pair comes
        devices = watch.open_devices(station)
        recorder = station.open_recorder(MAX_LAG, MAX_LAG)
        stack.callback(recorder.close)
        loop = RecordingLoop(station.arm, station.rig, devices, recorder, state, terminal.warn)
        drawn = watch.show_state(
            lambda: show.render_recording(state.snapshot()), shown, _printer(state)
        )
        look = stack.enter_context(drawn)
        defects = loop.run(stack.enter_context(watch.stop_on_signal()), duration, look)
    _conclude(station, recorder.state(), state.snapshot(), defects)


def _settings(out: Path) -> RecordingSettings:
    """Where the session goes; InputError: something is there."""
    with refused_as_input_error(out):
        there = out.exists() or out.is_symlink()
    if there:
        remedy = "Give another name with -o, or remove it."
        raise InputError(out, "exists", "a session is recorded into a new folder", remedy)
    return RecordingSettings(out.parent, out.name.replace("%", "%%"))  # no marks of strftime


def _printer(state: show.RecordingState) -> Callable[[], None]:
    """Make what prints now and then: an object, or a line for each goal that has changed."""
    printed: dict[str, str] = {}  # words, by the goal's name
    due = time.monotonic() + (0.0 if terminal.as_json else LINES_PERIOD)

    def look() -> None:
        nonlocal due
        now = state.snapshot()
        if not now.goals or (time.monotonic() < due and not now.finished):
            return
        due = time.monotonic() + (RECORD_PERIOD if terminal.as_json else LINES_PERIOD)
        if terminal.as_json:
            goals = [show.goal_fields(goal) for goal in now.goals]
            terminal.record(
                "recording", pairs=now.pairs, readings=now.readings, dropped=dict(now.dropped),
                goals=goals, recording=now.recording,
            )  # fmt: skip
            return
        terminal.say(f"{now.pairs} pairs, {now.readings} readings. {show.title(now.goals)}:")
        for goal in now.goals:
            if now.finished or printed.get(goal.name) != goal.words:
                terminal.say(f"  {goal.name:<26}{show.bar(goal)}  {goal.words}")
        printed.update((goal.name, goal.words) for goal in now.goals)

    return look


def _conclude(
    station: RecordingStation,
    recorded: RecorderState,
    now: show.RecordingSnapshot,
    defects: tuple[str, ...],
) -> None:
    """Say what was recorded; raise what went wrong."""
    if defects:
        raise WatchDefectError(f"{' '.join(defects)} {recorded.sentence}.")
    if recorded.trouble:
        raise InputError(
            recorded.folders[0] if recorded.folders else station.recording.folder,
            f"recording has stopped, {recorded.pairs} pairs are whole: {recorded.trouble}",
            "a disk that takes files, has room and keeps up",
            "Record to another one, or at a lower rate.",
        )
    watch.require_recorded(station, recorded, now.devices)
    terminal.warn(*(f"{line.name}: {line.sentence}" for line in now.devices if not line.well))
    names = ", ".join(map(str, recorded.folders))
    if len(recorded.folders) > 1:
        terminal.warn(f"The controller's clock began anew: {names} are sessions of their own.")
    rig = "" if "rig.toml" in station.facts.files else " --rig rig.toml"
    terminal.say(f"{recorded.pairs} pairs and {recorded.readings} readings in {names}")
    terminal.say(f"Next: verify calibrate register {recorded.folders[0]}{rig} -o registered.toml")
    terminal.record(
        "result",
        out=[str(path) for path in recorded.folders],
        pairs=recorded.pairs,
        readings=recorded.readings,
        goals=[show.goal_fields(goal) for goal in now.goals],
    )
