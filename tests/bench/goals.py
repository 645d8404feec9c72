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
    along: str = ""  # of a point on a curve: what grows
    at: float = 0.0  # its value there

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
        """A value with three significant digits and the unit; four where three would hide a miss.

        A figure of 1.254 is not shown as 1.25 beside a goal of 1.25.
        """
        bounds = [bound for bound in (self.most, self.least) if bound is not None]
        digits = next(
            (n for n in range(3, 9) if value in bounds or all(
                float(f"{value:.{n}g}") != float(f"{bound:.{n}g}") for bound in bounds
            )),
            9,
        )  # fmt: skip
        text = f"{value:.0f}" if abs(value) >= 10**digits else f"{value:.{digits}g}"
        return text if self.unit == RATIO else f"{text} {self.unit}"

    def __str__(self) -> str:
        """The figure as a line."""
        held = f" (goal: {self.goal}; {'holds' if self.holds else 'FAILS'})" if self.goal else ""
        name = f"{self.name}, {self.along} {self.at:.3g}" if self.along else self.name
        return f"{name}: {self.shown(self.value)}{held}{self.note and f', {self.note}'}"

    def record(self) -> dict[str, object]:
        """The figure as JSON has it."""
        bounds = {"at_most": self.most, "at_least": self.least, "holds": self.holds}
        place = {"along": self.along, "at": self.at} if self.along else {}
        return {"name": self.name, "value": self.value, "unit": self.unit, **place, **bounds}


Line = Figure | str
Bench = Callable[[], Iterator[Line]]
