"""What a report shows of those who give it: logo, owner, templates of their own."""

import base64
import io
import re
import struct
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from PIL import Image

from reports.results import ReportError, one_line

MAX_BYTES = 2_000_000  # a page carries its logo along as text
MAX_PX = 4_000  # a side: 45 mm at more than 2000 dpi
MAX_WIDTH_MM, MAX_HEIGHT_MM = 45.0, 16.0  # a quarter of the text's width, three lines high
MAX_ASPECT_RATIO = 20.0  # ratio of the sides; a logo beyond it would be a line
MAX_OWNER_LENGTH = 80  # letters, what fits beside a logo
PNG = b"\x89PNG\r\n\x1a\n"
SVG_NAME = "{http://www.w3.org/2000/svg}svg"
ACTIVE_ELEMENTS = {"script", "foreignObject", "iframe", "handler", "listener", "audio", "video"}
LENGTH_PATTERN = re.compile(
    r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(px|pt|pc|mm|cm|in|em)?\s*"
)
TEMPLATE_FILES = ("report.html.j2", "report.css", "report.typ")

# What every template gets: the language of its text, and the words that both formats print.
LANGUAGE = "en"
WORDS = {
    "to_verdict": "To the verdict",
    "sections": "Sections",
    "appendix": "Appendix",
    "terms": "Terms",
    "blank": "not stated",
    "table": "Table",
    "figure": "Figure",
    "no_script": "This plot needs JavaScript; report.pdf holds it as well.",
    "page": "page",
    "of": "of",
    "logo": "Logo",
    "filter": "Filter",
    "filter_hint": "words, all of them",
    "rows": "rows",
}


@dataclass(frozen=True, slots=True)
class Logo:
    """A picture for the top of a report, and how large it stands there."""

    content: bytes  # a PNG or an SVG
    is_svg: bool
    width_mm: float
    height_mm: float

    @property
    def size(self) -> dict[str, float]:
        """How large it stands, as templates are given it."""
        return {"width_mm": self.width_mm, "height_mm": self.height_mm}

    @property
    def address(self) -> str:
        """Give it as an address that holds the picture itself."""
        kind = "svg+xml" if self.is_svg else "png"
        return f"data:image/{kind};base64,{base64.b64encode(self.content).decode()}"


@dataclass(frozen=True, slots=True)
class Look:
    """How a report looks, apart from what it says; one without any wish has the usual look."""

    logo: Logo | None = None  # at its top
    owner: str = ""  # a line at its top: whose report it is
    templates: Path | None = None  # the user's own: report.html.j2, report.css or report.typ


DEFAULT_BRANDING = Look()


def check_owner(text: str) -> str:
    """Take the line that says whose report it is; ReportError: empty, too long or two lines."""
    if not text.strip() or len(text) > MAX_OWNER_LENGTH or one_line(text) != text:
        raise ReportError(
            "--owner", f"is {one_line(text)[:MAX_OWNER_LENGTH]!r}",
            f"one line of at most {MAX_OWNER_LENGTH} letters is expected", "Shorten it.",
        )  # fmt: skip
    return text


def check_templates(folder: Path) -> Path:
    """Check that a folder holds a template; raises ReportError: it holds none."""
    if not any((folder / name).is_file() for name in TEMPLATE_FILES):
        found = "holds none of them" if folder.is_dir() else "is no folder"
        raise ReportError(
            folder, found,
            f"a folder with {', '.join(TEMPLATE_FILES)}, or one of them, is expected",
            "Put one there: docs/reports.md says how it is written.",
        )  # fmt: skip
    return folder


def read_logo(path: Path) -> Logo:
    """Read a logo and see that it is a picture and nothing else.

    Raises:
        ReportError: it cannot be read; is neither PNG nor SVG, or a damaged one; is too large; or
            is an SVG that runs or fetches something.
    """
    try:
        if path.exists() and not path.is_file():  # a device or a pipe may never end
            raise _invalid_logo(path, "cannot be read (no plain file)", "a PNG or SVG")
        if path.stat().st_size > MAX_BYTES:
            raise _invalid_logo(path, f"has {path.stat().st_size / 1e6:.1f} MB", "at most 2 MB")
        content = path.read_bytes()
    except OSError as problem:
        raise _invalid_logo(path, f"cannot be read ({problem.strerror})", "a PNG or SVG") from None
    if content.startswith(PNG):
        return _fit_logo(path, content, *_png_size(path, content), is_svg=False)
    if b"<svg" in content[:4096] or b":svg" in content[:4096]:
        return _fit_logo(path, content, *_svg_size(path, content), is_svg=True)
    raise _invalid_logo(path, "is neither", "a PNG or SVG")


def _fit_logo(path: Path, content: bytes, width: float, height: float, *, is_svg: bool) -> Logo:
    ratio = width / height if height > 0 else 0.0
    if not 1 / MAX_ASPECT_RATIO <= ratio <= MAX_ASPECT_RATIO:
        raise _invalid_logo(
            path, f"is {width:g} x {height:g}", f"sides of at most {MAX_ASPECT_RATIO:g} to 1"
        )
    shown = min(MAX_WIDTH_MM, MAX_HEIGHT_MM * ratio)
    return Logo(content, is_svg, round(shown, 2), round(shown / ratio, 2))


def _png_size(path: Path, content: bytes) -> tuple[float, float]:
    if len(content) < 24:
        raise _invalid_logo(path, "is a damaged PNG", "a whole one")
    width, height = struct.unpack(">II", content[16:24])  # IHDR, the first chunk of every PNG
    if max(width, height) > MAX_PX:  # asked before anybody unpacks it
        raise _invalid_logo(path, f"has {width} x {height} px", f"at most {MAX_PX} a side")
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as picture:
            picture.load()
    except (OSError, SyntaxError, ValueError, EOFError):
        raise _invalid_logo(path, "is a damaged PNG", "a whole one") from None
    return width, height


def _svg_size(path: Path, content: bytes) -> tuple[float, float]:
    """Look an SVG through for what is no picture, and give its width and height."""
    if b"<!ENTITY" in content:  # a few can unfold to gigabytes
        raise _invalid_logo(path, "defines entities", "a plain SVG")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError):
        raise _invalid_logo(path, "is a damaged SVG", "a whole one") from None
    if root.tag != SVG_NAME:
        raise _invalid_logo(path, "is XML but no SVG", "a PNG or SVG")
    for element in root.iter():
        _check_element(path, element)
    parts = re.findall(r"[-+.\deE]+", root.get("viewBox", ""))
    box = [float(part) for part in parts if LENGTH_PATTERN.fullmatch(part.lstrip("+-"))]
    if len(box) == 4:
        return box[2], box[3]
    sides = [LENGTH_PATTERN.fullmatch(root.get(name, "")) for name in ("width", "height")]
    if sides[0] is None or sides[1] is None:
        raise _invalid_logo(path, "has no viewBox and no width and height", "an SVG that has")
    return float(sides[0][1]), float(sides[1][1])


def _check_element(path: Path, element: ElementTree.Element) -> None:
    name = str(element.tag).rpartition("}")[2]
    if name in ACTIVE_ELEMENTS:
        raise _invalid_logo(path, f"holds a <{name}>", "a plain SVG")
    texts = [element.text or ""] if name == "style" else []
    for key, value in element.attrib.items():
        plain = key.rpartition("}")[2]
        if plain.lower().startswith("on"):
            raise _invalid_logo(path, f"runs something ({plain})", "a plain SVG")
        if plain == "href" and not re.match(r"#|data:image/(png|jpeg);", value.strip()):
            raise _invalid_logo(
                path, f'fetches "{value[:40]}"', "a plain SVG with all it shows in it"
            )
        texts.append(value)
    for text in texts:
        if re.search(r"url\(\s*['\"]?(?!\s*['\"]?#)|@import", text, re.IGNORECASE):
            raise _invalid_logo(path, "fetches something by its style", "a plain SVG")


def _invalid_logo(path: Path, found: str, expected: str) -> ReportError:
    return ReportError(path, found, f"expected: {expected}", "Give another file as --logo.")
