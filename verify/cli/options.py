"""Options that several commands share, each declared once, and the checks of their values."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option
from typer.core import TyperCommand

from verify.cli.terminal import terminal
from verify.errors import InputError

if TYPE_CHECKING:  # imported when a command runs: `--help` answers at once
    from verify.io.session.keys import Tolerance
    from verify.live.page.feed import Page, PageSource

_SECONDS_PER_UNIT = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}


def parse_duration(text: str | float) -> float:
    """Read a duration such as 60s, 10m, 1.5h, or a number of seconds; s; else InputError."""
    parts = re.fullmatch(r"\s*([0-9.]+)\s*([a-z]*)\s*", str(text)) or ("", "", "")
    try:
        value = float(parts[1]) * _SECONDS_PER_UNIT[parts[2]]
    except (ValueError, KeyError):
        found = f'"{text}" is not a duration'
        raise InputError("--for", found, "seconds, minutes or hours", "Example: 10m") from None
    require_positive({"--for": value})
    return value


@dataclass(frozen=True, slots=True)
class CornerCounts:
    """Inner corners of a board, one fewer than squares."""

    columns: int
    rows: int

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"


def parse_corners(text: str | CornerCounts) -> CornerCounts:
    """Read two counts, like 9x7; else InputError."""
    counts = re.fullmatch(r"(\d{1,3})\s*[xX×,]\s*(\d{1,3})", str(text).strip())
    if counts is None:
        expected = "two counts are expected, like 9x7"
        raise InputError("--corners", f'is "{text}"', expected, "Count where four squares meet.")
    return CornerCounts(int(counts[1]), int(counts[2]))


@dataclass(frozen=True, slots=True)
class ToleranceOptions:
    """Tolerances as they were typed; None where nothing was."""

    joints_deg: str | None
    position_mm: float | None
    orientation_deg: float | None

    def __repr__(self) -> str:
        """Describe them as stored batch entries do; another text has all measured again."""
        return (
            f"Asked(joints_deg={self.joints_deg!r}, position_mm={self.position_mm!r}, "
            f"orientation_deg={self.orientation_deg!r})"
        )

    def checked_angles(self) -> list[float]:
        """Check what needs no robot; give joints' tolerances, degrees; InputError: not positive."""
        position, orientation = self.position_mm, self.orientation_deg
        require_positive({"--position-tolerance": position, "--orientation-tolerance": orientation})
        return [] if self.joints_deg is None else _parse_angles(self.joints_deg)

    def tolerance(self, joints: int) -> "Tolerance":
        """Turn them into m and rad for so many joints; InputError: not positive, or too few."""
        import numpy as np

        from verify.io.session.keys import Tolerance

        values = self.checked_angles()
        if len(values) not in (0, 1, joints):
            raise InputError(
                "--tolerance", f"{len(values)} numbers were given",
                f"the robot has {joints} joints",
                f"Give one number, or one per joint.{_decimal_comma(self.joints_deg or '')}",
            )  # fmt: skip
        position, orientation = self.position_mm, self.orientation_deg
        return Tolerance(
            joints=np.deg2rad(values * joints if len(values) == 1 else values) if values else None,
            position=None if position is None else position * 1e-3,
            orientation=None if orientation is None else float(np.deg2rad(orientation)),
        )


@dataclass(frozen=True, slots=True)
class PageOptions:
    """Where the page is served."""

    port: int
    address: str
    token: str | None

    def serve(self, source: "PageSource", **more: Any) -> "Page":
        """Serve a page and print its address; `more` goes to `Page`; InputError: it cannot be."""
        from verify.live.page.feed import Page

        page = Page(source, self.port, self.address, self.token, **more)
        terminal.say(f"page: {page.url}")
        terminal.record("page", url=page.url)
        return page


def duration_option(help_: str, *, show_default: bool = True) -> Any:
    """The option --for; `show_default=False`: the help names it, as seconds would be a number."""
    return Option(
        "--for", parser=parse_duration, metavar="<str>", show_default=show_default, help=help_
    )


JointTolerance = Annotated[
    str | None,
    Option(
        "--tolerance", help="Joint errors allowed, degrees: one number, or one per joint: 0.2,0.2,…"
    ),
]
PositionTolerance = Annotated[
    float | None, Option("--position-tolerance", help="Position error allowed, mm.")
]
OrientationTolerance = Annotated[
    float | None, Option("--orientation-tolerance", help="Orientation error allowed, degrees.")
]
PagePort = Annotated[int, Option(min=0, max=65535, help="The page's port; 0: any that is free.")]
PageAddress = Annotated[str, Option(help="The page's address; any other address needs a token.")]
PageToken = Annotated[
    str | None,
    Option(
        envvar="VERIFY_PAGE_TOKEN",  # a command line stands in the list of processes
        help="What viewers must show; 16 characters or more.",
    ),
]
Corners = Annotated[
    CornerCounts | None,
    Option(
        parser=parse_corners,
        metavar="<str>",
        help="Inner corners of the board, instead of board.toml: 9x7.",
    ),
]
SquareMm = Annotated[float | None, Option(help="Edge of a square, mm, instead of board.toml.")]
RigOut = Annotated[Path, Option("-o", "--out", help="The rig file to write.")]
ReportOut = Annotated[Path | None, Option("--report", help="Folder of the report.")]
ReplaceFiles = Annotated[bool, Option("--force", help="Replace files that are there.")]
ReplaceInFolder = Annotated[
    bool, Option("--force", help="Replace files in a folder that is not empty.")
]
WriteIntoFolder = Annotated[bool, Option("--force", help="Write into a folder that exists.")]


class Command(TyperCommand):
    """A command that is given neither an empty word nor a number that is not finite."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; raises InputError, before anything is done, for such a value."""
        for name, value in _given(self.params, ctx.params):
            if value == "":
                remedy = "Give one, or leave it out; in a script, see whether the variable is set."
                raise InputError(name, "is empty", "a value is needed", remedy)
            if isinstance(value, float) and not math.isfinite(value):
                raise InputError(name, f"is {value:g}", "a finite number is expected")
        return super().invoke(ctx)


def _given(parameters: list[Any], values: dict[str, Any]) -> Iterator[tuple[str, object]]:
    """Yield each value with its option or argument, several values of one apart."""
    for one in parameters:
        name = one.opts[-1] if one.param_type_name == "option" else one.name.upper()
        value = values.get(one.name)
        for part in value if isinstance(value, list | tuple) else (value,):
            yield name, part


def refuse_options(given: Mapping[str, bool], found: str, expected: str, remedy: str) -> None:
    """Refuse options that would do nothing, by whether given; the InputError names the first."""
    for name in (name for name, used in given.items() if used):
        raise InputError(name, found, expected, remedy)


def require_positive(
    values: Mapping[str, float | None], *, zero: bool = False, remedy: str = ""
) -> None:
    """Refuse numbers not positive (or 0, with `zero`) but None; the InputError names the first."""
    for name, value in values.items():
        if value is None or (math.isfinite(value) and (value > 0 or (zero and value == 0))):
            continue
        expected = f"a number above {'or at ' if zero else ''}0 is needed"
        raise InputError(name, f"{value:g}", expected, remedy)


def _parse_angles(text: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(
            "--tolerance", f'"{text}" is not a number of degrees',
            "one number is expected, or one per joint with commas between", "Example: 0.2",
        ) from None  # fmt: skip
    for value in values:
        require_positive({"--tolerance": value}, remedy=_decimal_comma(text).strip())
    return values


def _decimal_comma(text: str) -> str:
    """Say how a number is written that may have a decimal comma; empty for other texts."""
    parts = re.fullmatch(r"\s*(\d+),(\d+)\s*", text)
    return f" A decimal comma is not understood: write {parts[1]}.{parts[2]}." if parts else ""
