"""What can be seen of a report: its text on the screen, and the ink of its printed pages."""

import io
import shutil
import subprocess
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from tests.support.devices.chromium import Tab

MIN_TEXT_PX = 9.0
MIN_CONTRAST, MIN_CONTRAST_LARGE = 4.5, 3.0  # WCAG 2.2, 1.4.3, level AA
LARGE_PX, LARGE_BOLD_PX = 24.0, 18.66  # of the same: 18 pt, or 14 pt and bold
KINDS = (
    "every_cause", "good", "motion", "not_held", "fleet", "grab", "identification", "plan",
)  # fmt: skip
LIMIT_MS = 120_000.0  # until the plots are drawn
SETTLED = "document.documentElement.dataset.drawn !== undefined || !document.querySelector('.plot')"
# every piece of text that is to be seen, with the place and the colour of its letters
TEXTS = """() => {
  const SEEN = { visibilityProperty: true, opacityProperty: true };
  const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, parent = node.parentElement;
    if (!node.data.trim() || !parent.checkVisibility(SEEN)) continue;
    if (parent.closest("script, style, noscript, title, .modebar")) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    const box = range.getClientRects()[0], style = getComputedStyle(parent);
    if (!box || box.right < 0) continue;
    found.push([node.data.trim(), box.left + scrollX, box.top + scrollY, box.width, box.height,
      parseFloat(style.fontSize), Number(style.fontWeight) >= 700,
      parent.ownerSVGElement ? style.fill : style.color]);
  }
  return found;
}"""
# labels of plots that leave their drawing, and labels of one axis that touch
CLIPPED = """() => [...document.querySelectorAll(".plot .main-svg")].flatMap((svg) => {
  const all = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("text")].filter((text) => {
    const box = text.getBoundingClientRect();
    return box.width && (box.left < all.left - 1 || box.right > all.right + 1
      || box.top < all.top - 1 || box.bottom > all.bottom + 1);
  }).map((text) => text.closest(".plot").id + ": " + text.textContent);
})"""
TOUCHING = """() => [...document.querySelectorAll(".xaxislayer-above > *")].flatMap((axis) => {
  const boxes = [...axis.querySelectorAll(".xtick text")]
    .map((text) => [text.getBoundingClientRect(), text])
    .sort((a, b) => a[0].left - b[0].left);
  return boxes.slice(1).filter(([box], i) => box.left < boxes[i][0].right - 1 && box.height < 20)
    .map(([, text]) => text.closest(".plot").id + ": " + text.textContent);
})"""
# numbers in the cells of a grid that touch their neighbours
CROWDED = """() => [...document.querySelectorAll(".cartesianlayer > .subplot")].flatMap((panel) => {
  const boxes = [...panel.querySelectorAll(".textpoint text")]
    .map((text) => [text.getBoundingClientRect(), text])
    .sort((a, b) => Math.round(a[0].top) - Math.round(b[0].top) || a[0].left - b[0].left);
  return boxes.slice(1).filter(([box], i) =>
    Math.abs(box.top - boxes[i][0].top) < 2 && box.left < boxes[i][0].right)
    .map(([, text]) => text.closest(".js-plotly-plot").id + ": " + text.textContent);
})"""


@dataclass(frozen=True)
class Text:
    """Letters on a page: place and size in px, colour as 0 … 1."""

    words: str
    left: float
    top: float
    width: float
    height: float
    size: float
    bold: bool
    colour: NDArray[np.float64]

    @property
    def least_contrast(self) -> float:
        large = self.size >= (LARGE_BOLD_PX if self.bold else LARGE_PX)
        return MIN_CONTRAST_LARGE if large else MIN_CONTRAST


def wait_for_plots(tab: Tab) -> None:
    """Wait until the plots are drawn, which takes long without a graphics card."""
    tab.page.wait_for_function(SETTLED, polling=100, timeout=LIMIT_MS)


def show_all(tab: Tab) -> None:
    """Wait until all plots are drawn, those of folded parts too."""
    wait_for_plots(tab)
    tab.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
    tab.page.wait_for_timeout(400)  # ms: `toggle` comes later, and plots follow it


def texts(tab: Tab) -> list[Text]:
    found = []
    for words, left, top, width, height, size, bold, colour in tab.evaluate(TEXTS):
        channels = colour.partition("(")[2].rstrip(")").split(",")[:3]
        rgb = np.array([float(c) / 255 for c in channels])
        found.append(Text(words, left, top, width, height, size, bold, rgb))
    return found


def small(tab: Tab) -> list[str]:
    """Texts whose letters are too small to be read."""
    return [f"{text.words}: {text.size} px" for text in texts(tab) if text.size < MIN_TEXT_PX]


def faint(tab: Tab) -> list[str]:
    """Texts with too little contrast to what is behind them: the commonest colour around them."""
    every = texts(tab)
    picture = imread(io.BytesIO(tab.page.screenshot(full_page=True)), format="png")[:, :, :3]
    packed = np.round(255 * picture).astype(np.int64) @ [65536, 256, 1]
    poor = []
    for text in every:
        rows = slice(round(text.top), round(text.top + text.height) + 1)
        columns = slice(round(text.left), round(text.left + text.width) + 1)
        colours, counts = np.unique(packed[rows, columns], return_counts=True)
        if not len(colours):
            continue
        commonest = int(colours[int(np.argmax(counts))])
        behind = np.array([commonest >> 16, commonest >> 8 & 255, commonest & 255]) / 255
        ratio = _contrast(text.colour, behind)
        if ratio < text.least_contrast:
            poor.append(f"{text.words}: {ratio:.1f}, {text.colour} on {behind}")
    return poor


def _contrast(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    bright, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def _luminance(colour: NDArray[np.float64]) -> float:
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Ink:
    """What is printed between header and footer of a page, as shares of its height and width."""

    bottom: float  # lower edge of the last ink, from the top of the text's area
    left: float
    right: float


TEXT_TOP, TEXT_BOTTOM = 22 / 297, 1 - 22 / 297  # margins of the report's pages, A4
DOTS_PER_INCH = 40


def printed_pages(pdf: bytes, folder: Path) -> list[Ink]:
    """The ink of every page; skip without pdftoppm."""
    tool = shutil.which("pdftoppm")
    if tool is None:
        pytest.skip("pdftoppm is not installed (poppler-utils)")
    command = [tool, "-r", str(DOTS_PER_INCH), "-gray", "-png", "-", str(folder / "page")]
    subprocess.run(command, check=True, input=pdf)
    return [_ink(imread(path)) for path in sorted(folder.glob("page*.png"))]


def _ink(page: NDArray[np.float64]) -> Ink:
    height, width = page.shape[:2]
    dark = page.reshape(height, width, -1)[:, :, 0] < 0.9
    across = np.flatnonzero(dark.any(axis=0))
    top, bottom = round(TEXT_TOP * height), round(TEXT_BOTTOM * height)
    down = np.flatnonzero(dark[top:bottom].any(axis=1))
    last = float(down.max()) / (bottom - top) if len(down) else 0.0
    return Ink(last, float(across.min()) / width, float(across.max() + 1) / width)


def half_empty(pages: list[Ink]) -> list[int]:
    """Numbers of pages, from 1, that are under half full; the last may be."""
    return [place for place, (page, _) in enumerate(pairwise(pages), 1) if page.bottom < 0.5]


def beyond_margin(pages: list[Ink], margin: float) -> list[int]:
    """Numbers of pages with ink beyond a margin, a share of the width."""
    return [
        place
        for place, page in enumerate(pages, 1)
        if page.left < margin or page.right > 1 - margin
    ]
