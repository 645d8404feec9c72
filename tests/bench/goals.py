"""A benchmark's figures, with their goals: what `make bench` prints and writes as JSON.

    yield Figure("analysis / decoding, MJPEG", 1.18, "ratio", most=1.25)

prints `analysis / decoding, MJPEG: 1.18 (goal: at most 1.25; holds)`. A benchmark yields figures,
and plain lines of text for what is no figure.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

RATIO = "ratio"  # a unit that is not printed


@dataclass(frozen=True)
class Figure:
    """One measured figure, and the bound it must keep, if it has one."""

    name: str
    value: float
    unit: str = RATIO
    most: float | None = None  # the goal: at most this, in the same unit
    least: float | None = None  # the goal: at least this
    note: str = ""  # printed behind it

    @property
    def holds(self) -> bool | None:
        """Whether the goal is met; None without one. A figure that is nan meets none."""
        if self.most is None and self.least is None:
            return None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)

    @property
    def goal(self) -> str:
        """The goal as text, "" without one."""
        bounds = (("at most", self.most), ("at least", self.least))
        return " and ".join(f"{word} {self.shown(x)}" for word, x in bounds if x is not None)

    def shown(self, value: float) -> str:
        """A value with three significant digits and the unit."""
        digits = f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
        return digits if self.unit == RATIO else f"{digits} {self.unit}"

    def __str__(self) -> str:
        """The figure as a line."""
        held = f" (goal: {self.goal}; {'holds' if self.holds else 'FAILS'})" if self.goal else ""
        return f"{self.name}: {self.shown(self.value)}{held}{self.note and f', {self.note}'}"

    def record(self) -> dict[str, object]:
        """The figure as JSON has it."""
        bounds = {"at_most": self.most, "at_least": self.least, "holds": self.holds}
        return {"name": self.name, "value": self.value, "unit": self.unit, **bounds}


Line = Figure | str
Bench = Callable[[], Iterator[Line]]
