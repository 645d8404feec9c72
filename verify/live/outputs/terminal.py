"""The live table of a run in a terminal, drawn a few times a second."""

import math
import time
from collections.abc import Callable, Iterable
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live as Display
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from verify.errors import one_line
from verify.live.protocols import Alarm
from verify.live.state import DeviceStatus, LiveSnapshot

REFRESH_PERIOD = 0.25  # s: quicker cannot be read
BAR_HALF_WIDTH = 13  # characters on either side of zero
MAX_ALARMS = 4  # shown
MIN_SCALE_DEG = 0.1  # degrees at the end of a bar, where no tolerance tells


class TerminalDisplay:
    """Draws what `render` gives, in a terminal a few times a second and at the context's end."""

    def __init__(self, console: Console, render: Callable[[], RenderableType]) -> None:
        self._display = Display(console=console, auto_refresh=False, transient=False)
        self._render, self._due = render, 0.0

    def __enter__(self) -> Self:
        self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._display.update(self._render(), refresh=True)
        self._display.stop()

    def draw(self) -> None:
        """Draw again if it is time."""
        now = time.monotonic()
        if now >= self._due:
            self._due = now + REFRESH_PERIOD
            self._display.update(self._render(), refresh=True)


def render_snapshot(now: LiveSnapshot, tolerance_deg: list[float] | None) -> RenderableType:
    """Lay a snapshot out."""
    parts: list[RenderableType] = [_joints(now, tolerance_deg), _line(now)]
    parts.append(render_devices(now.devices, now.recording))
    if now.alarms:
        lines = [_alarm(alarm) for alarm in now.alarms[:MAX_ALARMS]]
        parts.append(Panel(Group(*lines), title="alarms", title_align="left", border_style="red"))
    return Group(*parts)


def _joints(now: LiveSnapshot, tolerance_deg: list[float] | None) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("joint", "error", "± U", "", "alarm"):
        table.add_column(title, justify="right" if title else "left")
    row = now.row
    if row is None:
        return table
    for j, (error, u) in enumerate(zip(row.error.tolist(), row.uncertainty.tolist(), strict=True)):
        tolerance = tolerance_deg[j] if tolerance_deg is not None else None
        share = float(now.statistic[j]) if now.statistic is not None else 0.0
        valid = math.isfinite(error) and math.isfinite(u)
        degrees, doubt = math.degrees(error), math.degrees(u)
        beyond = valid and tolerance is not None and abs(degrees) > tolerance
        table.add_row(
            str(j + 1),
            Text(f"{degrees:+z.3f}°" if valid else "–", style="bold red" if beyond else ""),
            f"{2 * doubt:.3f}°" if valid else "–",
            _bar(degrees, doubt, tolerance) if valid else Text(row.status.replace("_", " ")),
            Text(f"{min(share, 1.0):.0%}", style="red" if share > 0.7 else ""),
        )
    return table


def _bar(error: float, u: float, tolerance: float | None) -> Text:
    """Zero in the middle, the error as a mark, twice its uncertainty about it."""
    scale = 1.5 * tolerance if tolerance is not None else max(MIN_SCALE_DEG, 1.5 * abs(error))
    cells = [" "] * (2 * BAR_HALF_WIDTH + 1)

    def place(value: float) -> int:
        cell = round(BAR_HALF_WIDTH + BAR_HALF_WIDTH * value / scale)
        return max(0, min(2 * BAR_HALF_WIDTH, cell))

    for cell in range(place(error - 2 * u), place(error + 2 * u) + 1):
        cells[cell] = "─"
    cells[BAR_HALF_WIDTH] = "┼" if cells[BAR_HALF_WIDTH] == "─" else "│"
    if tolerance is not None:
        for edge in (place(-tolerance), place(tolerance)):
            cells[edge] = "┊"
    cells[place(error)] = "●"
    return Text("".join(cells), style="cyan")


def _line(now: LiveSnapshot) -> Text:
    text = f"{now.measured} of {now.pairs} pairs measured, {now.rate:.1f}/s"
    if now.latency is not None:
        text += ", {:.0f}/{:.0f} ms p50/p99".format(*(p * 1e3 for p in now.latency))
    if now.row is not None and now.row.clock is not None:
        text += f"; clock {now.row.clock.words()}"
    if now.dropped:
        text += "; dropped " + ", ".join(f"{reason} ({n})" for reason, n in now.dropped.items())
    return Text(f"\n{text}", style="dim")


def render_devices(devices: Iterable[DeviceStatus], recording: str = "") -> Table:
    """Lay out a line a device, and one for the recording."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for line in devices:
        mark = Text("●", style="green") if line.well else Text("▲", style="bold red")
        table.add_row(mark, line.name, Text(one_line(line.sentence), style="dim"))
    if recording:
        table.add_row("", "recording", Text(one_line(recording), style="dim"))
    return table


def _alarm(alarm: Alarm) -> Text:
    at = time.strftime("%H:%M:%S", time.localtime(alarm.began))
    over = "" if alarm.ended is None else " Over."
    style = "bold red" if alarm.ended is None else "dim"
    return Text(f"{at} {one_line(alarm.text)}{over}", style=style)
