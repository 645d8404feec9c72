"""`verify grab` at work: the loop, who looks on, the operator's keys, and what is left behind."""

import json
import os
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import reports
from reports import Results, html, pdf
from reports.grab import document, outcome
from reports.results import plain
from verify.commands.asked import seconds
from verify.commands.grabbing_page import SELECTED, GrabPage, OnPage
from verify.commands.watching import PageWish, stopped_politely
from verify.grab.loop import Loop
from verify.grab.loop_record import Cycle
from verify.grab.record import FILM, GrabRecord, Told
from verify.grab.run import Ends, Outcome, Source, run
from verify.grab.selection import parse_box
from verify.grab.states import Event, State
from verify.grab.target import Drawn, Named, Target
from verify.grab.workspace import Workspace
from verify.page.grab_source import GrabFacts
from verify.recording.part import Facts
from verify.results_folder import RESULTS
from verify.terminal import terminal
from verify.writing import folder_written_whole

PATIENCE = 5.0  # s in a holding state, and the grab is over
PATIENCE_SHOWN = 60.0  # s likewise, where a person looks on and may select another target
KEYS = {
    "g": Event.GRAB,
    "h": Event.HOLD,
    "r": Event.RESUME,
    "u": Event.RETREAT,
}
QUIT = "q"
STDIN = 0  # its descriptor


@dataclass(frozen=True, slots=True)
class Wish:
    """What is asked for, as it was typed."""

    colour: str | None
    roi: str | None
    execute: bool
    auto: bool
    duration: str
    page: PageWish | None = None

    @property
    def given(self) -> Target | None:
        """What to grab; None: it is selected on the page.

        Raises:
            InputError: the box is none.
        """
        if self.roi is not None:
            return Drawn(parse_box(self.roi))
        return None if self.colour is None else Named(self.colour)

    @property
    def ends(self) -> Ends:
        """When it is over.

        Raises:
            InputError: the duration is none.
        """
        patience = PATIENCE if self.page is None else PATIENCE_SHOWN
        return Ends(seconds("--for", self.duration), patience, planned=self.page is None)


@dataclass(frozen=True, slots=True)
class Stage:
    """All that a grab runs on, wherever that comes from."""

    loop: Loop
    source: Source
    workspace: Workspace
    facts: Facts  # of the recorded session
    told: Told
    rate: float  # Hz
    keys: bool  # the operator's keys are listened to
    page: OnPage | None = None


def conduct(stage: Stage, ends: Ends, out: Path, *, force: bool) -> bool:
    """Grab, and leave film, session and report.

    Args:
        stage: what it runs on.
        ends: when it is over.
        out: the folder.
        force: write into a folder that exists.

    Returns:
        Whether it was lifted; or planned, where nothing was to move.

    Raises:
        InputError: the folder cannot be written, or the pictures teach no colour.
    """
    with folder_written_whole(out, force) as folder:
        record = GrabRecord(folder, stage.facts, stage.workspace, stage.told, stage.rate)
        try:
            with _served(stage, ends) as page:
                ended = _run(stage, ends, record, page)
        finally:
            record.close()
        aim = stage.loop.aim
        results = record.results(ended, aim)
        if page is not None:
            results = page.told(results)
        _write(results, folder)
    _say(results, out)
    return ended.state is State.LIFTED or (not stage.told.execute and aim.plan is not None)


def in_words(target: Target | None) -> str:
    """Name a target for the report; None: selected on the page."""
    if target is None:
        return SELECTED
    if isinstance(target, Named):
        return f"{target.colour} object"
    return "object in the box {},{},{},{}".format(*target.box)


@contextmanager
def _served(stage: Stage, ends: Ends) -> Iterator[GrabPage | None]:
    """Serve the page, where one is wanted."""
    on, told = stage.page, stage.told
    if on is None:
        yield None
        return
    said = f"{told.target}, {told.cell}"
    facts = GrabFacts(told.robot, said, on.setup, on.rig, told.execute, ends.duration)
    with closing(GrabPage(stage.loop, on, facts)) as page:
        yield page


def _run(stage: Stage, ends: Ends, record: GrabRecord, page: GrabPage | None) -> Outcome:
    state: State | None = None
    keys = Keys(STDIN) if stage.keys else None

    def look(cycle: Cycle) -> None:
        nonlocal state
        record.see(cycle)
        if page is not None:
            page.see(cycle)
        if cycle.state is not state:
            state = cycle.state
            terminal.say(f"{cycle.t:7.2f} s  {cycle.state.value}: {cycle.reason or 'ready'}")
            fields = {"t_s": round(cycle.t, 3), "state": state.value, "reason": cycle.reason}
            terminal.record({"type": "state", **fields})

    def orders() -> Sequence[Event]:
        pressed = () if keys is None else keys.pressed()
        return pressed if page is None else (*pressed, *page.orders())

    with stopped_politely() as stop:
        ended = run(
            stage.loop,
            stage.source,
            ends,
            look,
            orders,
            say=terminal.warn if page is None else page.answer,
            stop=lambda: stop.is_set() or (keys is not None and keys.quit),
        )
    if page is not None:
        page.end(ended)
    return ended


class Keys:
    """The operator's keys, each followed by Enter; read beside the loop.

    Args:
        descriptor: of the file that they come from.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._pressed: deque[Event] = deque()
        self.quit = False
        threading.Thread(target=self._read, name="keys", daemon=True).start()

    def pressed(self) -> Sequence[Event]:
        """Give what was pressed since last time."""
        return [self._pressed.popleft() for _ in range(len(self._pressed))]

    def _read(self) -> None:
        with suppress(OSError):  # no input at all: nobody presses a key
            # not sys.stdin's own lines: a thread that waits in there locks it to the very end
            while typed := os.read(self._descriptor, 1024):
                for word in typed.decode(errors="replace").split():
                    self._take(word)

    def _take(self, word: str) -> None:
        key = word.lower()
        if key == QUIT:
            self.quit = True
        elif key in KEYS:
            self._pressed.append(KEYS[key])
        else:
            terminal.warn(f'"{word}" is no key: {", ".join(KEYS)} or {QUIT}')


def _write(results: Results, folder: Path) -> None:
    reports.write(results, folder / RESULTS)
    text = json.dumps(plain(results.summary), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    told = document(results)
    (folder / "report.html").write_text(html.page(told), encoding="utf-8")
    (folder / "report.pdf").write_bytes(pdf.pages(told))


def _say(results: Results, out: Path) -> None:
    said = outcome(results.summary)
    terminal.say(f"{said.label}: {said.sentence}")
    terminal.say(f"Report: {out / 'report.html'} and {out / 'report.pdf'}; film: {out / FILM}")
    terminal.record({"type": "result", "out": str(out), "summary": plain(results.summary)})
