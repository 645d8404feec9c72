"""Run a grasp: loop, page, operator's keys, recording and report."""

import json
import os
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import reports
from reports import Results
from reports.format import html, pdf
from reports.grasp.document import document, outcome
from reports.results import to_json_value
from verify.cli.options import PageOptions
from verify.cli.terminal import terminal
from verify.cli.watch import stop_on_signal
from verify.core.records import StereoPair
from verify.core.rig import Rig
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.loop import GraspLoop
from verify.grasping.control.requests import OperatorRequests, select_target
from verify.grasping.control.run import GraspOutcome, PairSource, StopConditions, run
from verify.grasping.control.states import GraspEvent, GraspState
from verify.grasping.page import GraspFacts, GraspPageSource
from verify.grasping.planning.plan import GraspPlanner
from verify.grasping.planning.workspace import Workspace
from verify.grasping.record.record import VIDEO_FILE, GraspContext, GraspRecord
from verify.grasping.tracking.selection import parse_box
from verify.grasping.tracking.target import BoxSelection, ColourSelection, Target
from verify.io.files import write_folder_whole
from verify.io.results import RESULTS
from verify.live.page.feed import Page
from verify.live.recording.session import SessionFacts

SELECTED_NAME = "object selected on the page"


@dataclass(frozen=True, slots=True)
class PageContext:
    """What the page needs beside the loop."""

    wish: PageOptions
    setup: GraspPlanner
    rig: Rig
    selects: bool  # no target was given: it is selected there


class GraspPage:
    """A page that is served until `close`; all but that is called by the loop's own thread.

    Args:
        loop: not started yet.
        on: where, and what it needs.
        facts: what else it says.

    Raises:
        InputError: the page cannot be served.
    """

    def __init__(self, loop: GraspLoop, on: PageContext, facts: GraspFacts) -> None:
        self._loop, self._on = loop, on
        self._source, self._requests = GraspPageSource(facts), OperatorRequests()
        requests, wish = self._requests, on.wish
        self._page = Page(
            self._source, wish.port, wish.address, wish.token,
            {"hold": requests.hold}, {"grab": requests.grab, "select": requests.select},
        )  # fmt: skip
        self._pair: StereoPair | None = None  # of the last turn
        self._selected = ""
        self._trouble = ""
        terminal.say(f"page: {self.url}")
        terminal.record({"type": "page", "url": self.url})
        if on.selects:
            loop.look_for(None)
            terminal.say("Select the object on the page: drag a rectangle around it.")

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return self._page.url

    def see(self, cycle: LoopCycle) -> None:
        """Show a turn of the loop."""
        self._pair = cycle.pair
        self._source.show(cycle, self._loop, self._requests.stops)
        if self._page.trouble != self._trouble:
            self._trouble = self._page.trouble
            terminal.warn(f"{self._trouble}; this stops nothing, keys and Ctrl-C do")

    def orders(self) -> Sequence[GraspEvent]:
        """Give what was ordered since last time; go after what was selected."""
        passages = len(self._loop.machine.log)
        asked = self._requests.taken(passages, pictures=self._pair is not None)
        for words in asked.refused:
            self.answer(words)
        if asked.drawn is not None and self._pair is not None:
            self._choose(asked.drawn, self._pair)
        for event in asked.orders:
            terminal.say(f"page: {event.value}")
            terminal.record({"type": "page_order", "order": event.value})
        return asked.orders

    def answer(self, words: str) -> None:
        """Say why something that was asked for does not count."""
        terminal.warn(words)
        self._source.answer(words)

    def end(self, ended: GraspOutcome) -> None:
        """Say how it ended."""
        back = "the controls were given back" if ended.released else "NO controls were given back"
        after = back if self._loop.may_move else "nothing was moved"
        self._source.end(f"{ended.state.value}: {ended.reason or 'it had not begun'}; {after}")

    def told(self, results: Results) -> Results:
        """Name in the results what was selected here."""
        if not self._selected:
            return results
        return replace(results, summary={**results.summary, "target": self._selected})

    def close(self) -> None:
        """Show the end, and serve no more."""
        self._page.close()

    def _choose(self, drawn: BoxSelection, pair: StereoPair) -> None:
        where = f"{drawn.side} {','.join(map(str, drawn.box))}"
        if said := select_target(self._loop, self._on.rig, drawn, pair):
            self.answer(f"selection {where}: {said}")
            return
        self._selected = f"{SELECTED_NAME}, {where}"
        self._source.answer(self._selected)
        terminal.say(self._selected)
        terminal.record({"type": "selected", "side": drawn.side, "box_px": list(drawn.box)})


HOLDING_TIMEOUT = 5.0  # s in a holding state, and the grab is over
HOLDING_TIMEOUT_PAGE = 60.0  # s likewise, where a person looks on and may select another target
KEY_EVENTS = {
    "g": GraspEvent.GRAB,
    "h": GraspEvent.HOLD,
    "r": GraspEvent.RESUME,
    "u": GraspEvent.RETREAT,
}
QUIT_KEY = "q"
STDIN = 0  # its descriptor


@dataclass(frozen=True, slots=True)
class GraspOptions:
    """What is asked for, as it was typed."""

    colour: str | None
    roi: str | None
    execute: bool
    auto: bool
    duration: float  # s
    page: PageOptions | None = None

    @property
    def given(self) -> Target | None:
        """What to grab; None: it is selected on the page.

        Raises:
            InputError: the box is none.
        """
        if self.roi is not None:
            return BoxSelection(parse_box(self.roi))
        return None if self.colour is None else ColourSelection(self.colour)

    @property
    def ends(self) -> StopConditions:
        """When it is over."""
        patience = HOLDING_TIMEOUT if self.page is None else HOLDING_TIMEOUT_PAGE
        return StopConditions(self.duration, patience, planned=self.page is None)


@dataclass(frozen=True, slots=True)
class GraspRun:
    """All that a grab runs on, wherever that comes from."""

    loop: GraspLoop
    source: PairSource
    workspace: Workspace
    facts: SessionFacts  # of the recorded session
    told: GraspContext
    rate: float  # Hz
    keys: bool  # the operator's keys are listened to
    page: PageContext | None = None


def conduct(stage: GraspRun, ends: StopConditions, out: Path, *, force: bool) -> bool:
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
    with write_folder_whole(out, force) as folder:
        record = GraspRecord(folder, stage.facts, stage.workspace, stage.told, stage.rate)
        try:
            with _serve_page(stage, ends) as page:
                ended = _run(stage, ends, record, page)
        finally:
            record.close()
        aim = stage.loop.aim
        results = record.results(ended, aim)
        if page is not None:
            results = page.told(results)
        _write(results, folder)
    _print_outcome(results, out)
    return ended.state is GraspState.LIFTED or (not stage.told.execute and aim.plan is not None)


def target_name(target: Target | None) -> str:
    """Name a target for the report; None: selected on the page."""
    if target is None:
        return SELECTED_NAME
    if isinstance(target, ColourSelection):
        return f"{target.colour} object"
    return "object in the box {},{},{},{}".format(*target.box)


@contextmanager
def _serve_page(stage: GraspRun, ends: StopConditions) -> Iterator[GraspPage | None]:
    """Serve the page, where one is wanted."""
    on, told = stage.page, stage.told
    if on is None:
        yield None
        return
    said = f"{told.target}, {told.cell}"
    facts = GraspFacts(told.robot, said, on.setup, on.rig, told.execute, ends.duration)
    with closing(GraspPage(stage.loop, on, facts)) as page:
        yield page


def _run(
    stage: GraspRun, ends: StopConditions, record: GraspRecord, page: GraspPage | None
) -> GraspOutcome:
    state: GraspState | None = None
    keys = OperatorKeys(STDIN) if stage.keys else None

    def look(cycle: LoopCycle) -> None:
        nonlocal state
        record.add(cycle)
        if page is not None:
            page.see(cycle)
        if cycle.state is not state:
            state = cycle.state
            terminal.say(f"{cycle.t:7.2f} s  {cycle.state.value}: {cycle.reason or 'ready'}")
            fields = {"t_s": round(cycle.t, 3), "state": state.value, "reason": cycle.reason}
            terminal.record({"type": "state", **fields})

    def orders() -> Sequence[GraspEvent]:
        pressed = () if keys is None else keys.pressed()
        return pressed if page is None else (*pressed, *page.orders())

    with stop_on_signal() as stop:
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


class OperatorKeys:
    """The operator's keys, each followed by Enter; read beside the loop.

    Args:
        descriptor: of the file that they come from.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._pressed: deque[GraspEvent] = deque()
        self.quit = False
        threading.Thread(target=self._read, name="keys", daemon=True).start()

    def pressed(self) -> Sequence[GraspEvent]:
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
        if key == QUIT_KEY:
            self.quit = True
        elif key in KEY_EVENTS:
            self._pressed.append(KEY_EVENTS[key])
        else:
            terminal.warn(f'"{word}" is no key: {", ".join(KEY_EVENTS)} or {QUIT_KEY}')


def _write(results: Results, folder: Path) -> None:
    reports.write(results, folder / RESULTS)
    text = json.dumps(to_json_value(results.summary), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    told = document(results)
    (folder / "report.html").write_text(html.page(told), encoding="utf-8")
    (folder / "report.pdf").write_bytes(pdf.pages(told))


def _print_outcome(results: Results, out: Path) -> None:
    said = outcome(results.summary)
    terminal.say(f"{said.label}: {said.sentence}")
    terminal.say(
        f"Report: {out / 'report.html'} and {out / 'report.pdf'}; film: {out / VIDEO_FILE}"
    )
    terminal.record({"type": "result", "out": str(out), "summary": to_json_value(results.summary)})
