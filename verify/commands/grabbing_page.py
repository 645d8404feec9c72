"""The page of `verify grab`: what it shows, and what becomes of what is asked for there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from reports import Results
from verify.commands.watching import PageWish
from verify.grab.loop import Loop
from verify.grab.loop_record import Cycle
from verify.grab.operator_requests import Requests, choose
from verify.grab.plan import Planner
from verify.grab.run import Outcome
from verify.grab.states import Event
from verify.grab.target import Drawn
from verify.page.feed import Page
from verify.page.grab_source import GrabFacts, GrabSource
from verify.records import StereoPair
from verify.rig import Rig
from verify.terminal import terminal

SELECTED = "object selected on the page"


@dataclass(frozen=True, slots=True)
class OnPage:
    """What the page needs beside the loop."""

    wish: PageWish
    setup: Planner
    rig: Rig
    selects: bool  # no target was given: it is selected there


class GrabPage:
    """A page that is served until `close`; all but that is called by the loop's own thread.

    Args:
        loop: not started yet.
        on: where, and what it needs.
        facts: what else it says.

    Raises:
        InputError: the page cannot be served.
    """

    def __init__(self, loop: Loop, on: OnPage, facts: GrabFacts) -> None:
        self._loop, self._on = loop, on
        self._source, self._requests = GrabSource(facts), Requests()
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

    def see(self, cycle: Cycle) -> None:
        """Show a turn of the loop."""
        self._pair = cycle.pair
        self._source.see(cycle, self._loop, self._requests.stops)
        if self._page.trouble != self._trouble:
            self._trouble = self._page.trouble
            terminal.warn(f"{self._trouble}; this stops nothing, keys and Ctrl-C do")

    def orders(self) -> Sequence[Event]:
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

    def end(self, ended: Outcome) -> None:
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

    def _choose(self, drawn: Drawn, pair: StereoPair) -> None:
        where = f"{drawn.side} {','.join(map(str, drawn.box))}"
        if said := choose(self._loop, self._on.rig, drawn, pair):
            self.answer(f"selection {where}: {said}")
            return
        self._selected = f"{SELECTED}, {where}"
        self._source.answer(self._selected)
        terminal.say(self._selected)
        terminal.record({"type": "selected", "side": drawn.side, "box_px": list(drawn.box)})
