"""Taking board pictures in a terminal: what is missing, and what becomes of the board in view."""

import time

from rich.console import Console, Group, RenderableType
from rich.live import Live as Display
from rich.table import Table
from rich.text import Text

from verify.errors import one_line
from verify.live.board_goals import Coverage
from verify.live.board_state import MOVING, READY, BoardSnapshot, BoardState

EVERY = 0.25  # s: quicker cannot be read
SHADES = " ░▒▓█"  # of a cell with no corner, with some, with many
MANY = 12  # corners in a cell
STYLES = {READY: "bold green", MOVING: "yellow"}


class BoardScreen:
    """Shows a state; used as a context.

    Args:
        console: to draw on.
        help_: what the keys do.
    """

    def __init__(self, console: Console, help_: str) -> None:
        self._display = Display(console=console, auto_refresh=False, transient=False)
        self._help, self._due = help_, 0.0

    def __enter__(self) -> "BoardScreen":
        self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._display.stop()

    def look(self, state: BoardState) -> None:
        """Draw again, if it is time."""
        now = time.monotonic()
        snapshot = state.snapshot()
        if now >= self._due or snapshot.finished:
            self._due = now + EVERY
            self._display.update(drawn(snapshot, self._help), refresh=True)


def drawn(now: BoardSnapshot, help_: str) -> RenderableType:
    """Lay a snapshot out."""
    goals = Table(box=None, show_header=False, pad_edge=False)
    for goal in now.goals:
        mark = Text("●", style="green") if goal.reached else Text("○", style="yellow")
        goals.add_row(mark, goal.name, Text(goal.words, style="dim" if goal.reached else ""))
    devices = Table(box=None, show_header=False, pad_edge=False)
    for line in now.devices:
        mark = Text("●", style="green") if line.well else Text("▲", style="bold red")
        devices.add_row(mark, line.name, Text(one_line(line.sentence), style="dim"))
    told = Text(now.words, style=STYLES.get(now.status, "cyan"))
    last = Text(now.last, style="dim")
    return Group(_maps(now.coverage), goals, devices, last, told, Text(help_, style="dim"))


def _maps(covered: tuple[Coverage, ...]) -> RenderableType:
    """Both images, a sign for each cell."""
    table = Table(box=None, pad_edge=False)
    for name in ("left", "right"):
        table.add_column(name)
    table.add_row(*(_map(c) for c in covered))
    return table


def _map(covered: Coverage) -> Text:
    last = len(SHADES) - 1
    lines = [
        "".join(2 * SHADES[min(-(-int(n) * last // MANY), last)] for n in row)
        for row in covered.cells
    ]
    return Text("\n".join(lines), style="green on grey23")
