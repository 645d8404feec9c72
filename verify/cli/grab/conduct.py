"""Run a grasp: loop, page, operator's keys, recording and report."""

from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path

from reports.grasp.certificate import outcome, seen_left_behind
from reports.results import to_json_value
from verify.cli.options import PageOptions
from verify.cli.terminal import STDIN, read_lines, report_files, terminal
from verify.cli.watch import stop_on_signal
from verify.core.records import StereoPair
from verify.core.rig import Rig
from verify.grasping.control.aim import LoopCycle
from verify.grasping.control.loop import GraspLoop
from verify.grasping.control.requests import OperatorRequests, select_target
from verify.grasping.control.run import GraspOutcome, PairSource, StopConditions, run
from verify.grasping.control.states import GraspEvent, GraspState
from verify.grasping.page import GraspFacts, GraspPageSource
from verify.grasping.planning.workspace import Workspace
from verify.grasping.record.record import VIDEO_FILE, GraspContext, GraspRecord
from verify.grasping.tracking.selection import parse_box
from verify.grasping.tracking.target import BoxSelection, ColourSelection, Target
from verify.io.files import write_folder_whole
from verify.io.results import write_report_folder
from verify.live.recording.session import SessionFacts

SELECTED_NAME = "object selected on the page"


class GraspPage:
    """A page that is served until `close`; the loop's own thread calls everything else.

    The loop is not started yet; `facts` are the constants shown; with `selects` there is no target
    yet and the user selects it on the page. Raises InputError where it cannot be served.
    """

    def __init__(
        self, loop: GraspLoop, options: PageOptions, facts: GraspFacts, *, selects: bool
    ) -> None:
        self._loop, self._rig = loop, facts.rig
        self._source, self._requests = GraspPageSource(facts), OperatorRequests()
        requests = self._requests
        self._page = options.serve(
            self._source,
            commands={"hold": requests.hold},
            inputs={"grab": requests.grab, "select": requests.select},
        )
        self._pair: StereoPair | None = None  # of the last cycle
        self.selected = ""  # what was selected on the page
        self._trouble = ""
        if selects:
            loop.look_for(None)
            terminal.say("Select the object on the page: drag a rectangle around it.")

    def show(self, cycle: LoopCycle) -> None:
        """Show a cycle of the loop."""
        self._pair = cycle.pair
        self._source.show(cycle, self._loop, self._requests.stops)
        if self._page.trouble != self._trouble:
            self._trouble = self._page.trouble
            terminal.warn(f"{self._trouble}; this stops nothing, keys and Ctrl-C do")

    def orders(self) -> Sequence[GraspEvent]:
        """Return the orders since the last call; track the object that was selected."""
        passages = len(self._loop.machine.log)
        orders, drawn, refused = self._requests.taken(passages, pictures=self._pair is not None)
        for reason in refused:
            self.refuse(reason)
        if drawn is not None and self._pair is not None:
            self._select(drawn, self._pair)
        for event in orders:
            terminal.say(f"page: {event.value}")
            terminal.record("page_order", order=event.value)
        return orders

    def refuse(self, reason: str) -> None:
        """Say why a request is ignored."""
        terminal.warn(reason)
        self._source.answer(reason)

    def end(self, outcome: GraspOutcome) -> None:
        """Show how the grasp ended."""
        back = "the controls were given back" if outcome.released else "NO controls were given back"
        after = back if self._loop.may_move else "nothing was moved"
        self._source.end(f"{outcome.state.value}: {outcome.reason or 'it had not begun'}; {after}")

    def close(self) -> None:
        """Show the end, and stop serving."""
        self._page.close()

    def _select(self, drawn: BoxSelection, pair: StereoPair) -> None:
        where = f"{drawn.side} {','.join(map(str, drawn.box))}"
        if reason := select_target(self._loop, self._rig, drawn, pair):
            self.refuse(f"selection {where}: {reason}")
            return
        self.selected = f"{SELECTED_NAME}, {where}"
        self._source.answer(self.selected)
        terminal.say(self.selected)
        terminal.record("selected", side=drawn.side, box_px=list(drawn.box))


HOLDING_TIMEOUT = 5.0  # s in a holding state
HOLDING_TIMEOUT_PAGE = 60.0  # s in a holding state where a person may select another target
KEY_EVENTS = {
    "g": GraspEvent.GRAB,
    "h": GraspEvent.HOLD,
    "r": GraspEvent.RESUME,
    "u": GraspEvent.RETREAT,
}
QUIT_KEY = "q"
WAITS = "waits for pictures, joint angles, arm and gripper"


@dataclass(frozen=True, slots=True)
class GraspOptions:
    """Options of a grasp, as they were typed."""

    colour: str | None
    roi: str | None
    execute: bool
    auto: bool
    duration: float  # s
    page: PageOptions | None = None

    @property
    def target(self) -> Target | None:
        """The object to grasp; None: it is selected on the page; InputError: the box is none."""
        if self.roi is not None:
            return BoxSelection(parse_box(self.roi))
        return None if self.colour is None else ColourSelection(self.colour)

    @property
    def stop_conditions(self) -> StopConditions:
        """When the grasp is over."""
        patience = HOLDING_TIMEOUT if self.page is None else HOLDING_TIMEOUT_PAGE
        return StopConditions(self.duration, patience, planned=self.page is None)


@dataclass(frozen=True, slots=True)
class GraspRun:
    """What a grasp runs on, simulated or on a station."""

    loop: GraspLoop
    source: PairSource
    workspace: Workspace
    rig: Rig
    facts: SessionFacts  # of the recorded session
    context: GraspContext
    rate: float  # Hz
    keys: bool  # the operator's keys are read
    page: PageOptions | None


def conduct(stage: GraspRun, stop: StopConditions, out: Path, *, force: bool) -> bool:
    """Grasp; write film, session and report to `out`; True: lifted, or planned if none may move.

    Raises:
        InputError: the folder cannot be written, or the pictures teach no colour.
        KeyboardInterrupt: a signal ended the grasp before that; all is written.
    """
    context, aim = stage.context, stage.loop.aim
    with write_folder_whole(out, force) as folder:
        record = GraspRecord(folder, stage.facts, stage.workspace, context, stage.rate)
        try:
            with _serve_page(stage, stop.duration) as page:
                ended, interrupted = _run(stage, stop, record, page)
        finally:
            record.close()
        results = record.results(ended, aim)
        if page is not None and page.selected:
            results.summary["target"] = page.selected
        write_report_folder(results, folder, force=True)
    verdict = outcome(results.summary)
    terminal.say(f"{verdict.label}: {verdict.sentence}")
    terminal.say(f"Report: {report_files(out)}; film: {out / VIDEO_FILE}")
    terminal.record("result", out=str(out), summary=to_json_value(results.summary))
    lifted = ended.state is GraspState.LIFTED and not seen_left_behind(results.summary)
    good = lifted or (not context.execute and aim.plan is not None)
    if interrupted and not good:
        raise KeyboardInterrupt
    return good


def target_name(target: Target | None) -> str:
    """Name a target for the report; None: selected on the page."""
    if target is None:
        return SELECTED_NAME
    if isinstance(target, ColourSelection):
        return f"{target.colour} object"
    return "object in the box {},{},{},{}".format(*target.box)


def _serve_page(stage: GraspRun, duration: float) -> AbstractContextManager[GraspPage | None]:
    """Serve the page with --page; `duration` in s."""
    context = stage.context
    if stage.page is None:
        return nullcontext()
    text = f"{context.target}, {context.cell}"
    facts = GraspFacts(context.robot, text, stage.workspace, stage.rig, context.execute, duration)
    selects = context.target == SELECTED_NAME
    return closing(GraspPage(stage.loop, stage.page, facts, selects=selects))


def _run(
    stage: GraspRun, conditions: StopConditions, record: GraspRecord, page: GraspPage | None
) -> tuple[GraspOutcome, bool]:
    """Grasp; also whether a signal ended it."""
    state: GraspState | None = None
    keys = OperatorKeys(STDIN) if stage.keys else None

    def look(cycle: LoopCycle) -> None:
        nonlocal state
        record.add(cycle)
        if page is not None:
            page.show(cycle)
        if cycle.state is not state:
            state = cycle.state
            terminal.say(f"{cycle.t:7.2f} s  {cycle.state.value}: {cycle.reason or WAITS}")
            terminal.record("state", t_s=round(cycle.t, 3), state=state.value, reason=cycle.reason)

    def orders() -> Sequence[GraspEvent]:
        pressed = () if keys is None else keys.pressed()
        return pressed if page is None else (*pressed, *page.orders())

    with stop_on_signal() as stop:
        ended = run(
            stage.loop,
            stage.source,
            conditions,
            look,
            orders,
            say=terminal.warn if page is None else page.refuse,
            stop=lambda: stop.is_set() or (keys is not None and keys.quit),
        )
    if page is not None:
        page.end(ended)
    return ended, stop.is_set()


class OperatorKeys:
    """The operator's keys, each followed by Enter; read beside the loop from a descriptor."""

    def __init__(self, descriptor: int) -> None:
        self._pressed: deque[GraspEvent] = deque()
        self.quit = False
        read_lines(descriptor, self._take)

    def pressed(self) -> Sequence[GraspEvent]:
        """Return the keys pressed since the last call, as events."""
        return [self._pressed.popleft() for _ in range(len(self._pressed))]

    def _take(self, line: str) -> None:
        for word in line.split():
            key = word.lower()
            if key == QUIT_KEY:
                self.quit = True
            elif key in KEY_EVENTS:
                self._pressed.append(KEY_EVENTS[key])
            else:
                terminal.warn(f'"{word}" is no key: {", ".join(KEY_EVENTS)} or {QUIT_KEY}')
