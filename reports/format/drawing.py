"""SVG, written directly: shapes and letters at places in points, colours and dashes by role."""

from collections.abc import Iterable
from html import escape

import numpy as np

from reports.document.charts import DASHES, PALETTE, STROKE, STROKES, Array
from reports.format.lettering import FAMILY, LINE_PITCH, text_height

DASH_LENGTHS = {"dash": (4.0, 2.0), "dot": (1.2, 1.6)}  # times the line's width
PT_PER_PX = 0.56  # a line on paper beside the same on a screen
CAP = 0.36  # of the letters' size: half a capital's height


class Drawing:
    """An SVG of a size in points; y points down."""

    def __init__(self, width: float, height: float) -> None:
        self.width, self.height = width, height
        self.parts: list[str] = []
        self.clips = 0

    def text(
        self, x: float, y: float, words: str, size: float, role: str = "ink", anchor: str = "middle"
    ) -> None:
        """Write words whose lines are centred on y; anchor start, middle or end at x."""
        lines = words.split("\n")
        y += CAP * size - text_height(words, size) / 2 + LINE_PITCH * size / 2
        for number, line in enumerate(lines):
            self.parts.append(
                f'<text x="{x:.2f}" y="{y + number * LINE_PITCH * size:.2f}" font-size="{size:g}" '
                f'text-anchor="{anchor}" fill="{colour(role)}">{escape(line)}</text>'
            )

    def turned(self, x: float, y: float, words: str, size: float, degrees: float = -90.0) -> None:
        """Write words about their middle, turned clockwise."""
        self.parts.append(f'<g transform="translate({x:.2f} {y:.2f}) rotate({degrees:.2f})">')
        self.text(0.0, 0.0, words, size)
        self.parts.append("</g>")

    def lines(
        self, pieces: Iterable[Array], role: str, width: float, dash: str = "", cap: str = "butt"
    ) -> None:
        """Draw open lines, (n, 2) each."""
        path = "".join(f"M{_places(piece)}" for piece in pieces)
        if path:
            self.parts.append(
                f'<path d="{path}" fill="none" {paint("stroke", role)} stroke-width="{width:g}" '
                f'stroke-linejoin="round" stroke-linecap="{cap}"{dashed(dash, width)}/>'
            )

    def areas(self, outlines: Iterable[Array], role: str, edge: str = "") -> None:
        """Fill closed outlines, (n, 2) each; `edge` are attributes of their outline."""
        path = "".join(f"M{_places(outline)}Z" for outline in outlines)
        if path:
            self.parts.append(f'<path d="{path}" {paint("fill", role)} {edge}/>')

    def dots(self, places: Array, role: str, radius: float, opacity: float = 1.0) -> None:
        """Draw filled circles at (n, 2) places."""
        if not len(places):
            return
        text = f'<circle cx="%.2f" cy="%.2f" r="{radius:g}"/>' * len(places)
        shown = text % tuple(places.ravel().tolist())
        self.parts.append(f"<g {paint('fill', role, opacity)}>{shown}</g>")

    def rings(self, places: Array, role: str, radius: float, width: float) -> None:
        """Draw open circles at (n, 2) places."""
        self.parts += [
            f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{radius:g}" fill="none" '
            f'{paint("stroke", role)} stroke-width="{width:g}"/>'
            for x, y in places
        ]

    def clip(self, left: float, top: float, right: float, bottom: float) -> None:
        """Show what follows, up to `unclip`, only within a rectangle."""
        self.clips += 1
        size = f'width="{right - left:.2f}" height="{bottom - top:.2f}"'
        self.parts.append(
            f'<clipPath id="c{self.clips}"><rect x="{left:.2f}" y="{top:.2f}" {size}/></clipPath>'
            f'<g clip-path="url(#c{self.clips})">'
        )

    def unclip(self) -> None:
        """End what `clip` began."""
        self.parts.append("</g>")

    def svg(self) -> bytes:
        """The drawing as a file."""
        size = f'width="{self.width:.2f}pt" height="{self.height:.2f}pt"'
        box = f'viewBox="0 0 {self.width:.2f} {self.height:.2f}"'
        inner = "\n".join(self.parts)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} {box}>\n'
            f'<g font-family="{FAMILY}">\n{inner}\n</g>\n</svg>\n'
        ).encode()


def colour(role: str) -> str:
    """Give a role's colour on paper, without its opacity."""
    return PALETTE[role][0][:7]


def paint(what: str, role: str, opacity: float = 1.0) -> str:
    """Give the attributes that fill or stroke in a role's colour."""
    opacity *= int(PALETTE[role][0][7:] or "ff", 16) / 255
    see_through = f' {what}-opacity="{opacity:.3g}"' if opacity < 1 else ""
    return f'{what}="{colour(role)}"{see_through}'


def dashed(dash: str, width: float) -> str:
    """Give the attribute of a dash's name; nothing for a solid line."""
    lengths = " ".join(f"{width * part:.2f}" for part in DASH_LENGTHS.get(dash, ()))
    return f' stroke-dasharray="{lengths}"' if lengths else ""


def line_width(role: str) -> float:
    """Give the width of a role's lines on paper, pt."""
    return PT_PER_PX * STROKES.get(role, STROKE)


def dash_of(role: str) -> str:
    """Give a role's dash, "" for a solid line."""
    return DASHES.get(role, "")


def _places(points: Array) -> str:
    text = " ".join(["%.2f,%.2f"] * len(points))
    return text % tuple(np.asarray(points).ravel().tolist())
