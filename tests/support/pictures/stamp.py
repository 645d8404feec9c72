"""PNG files of the documents: few colours, small, and stamped with what made them."""

import hashlib
import json
from io import BytesIO
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

from reports.document.blocks import Document, to_template_data
from verify import __version__

ROOT = Path(__file__).parents[3]
FOLDER = ROOT / "docs" / "pictures"
SOFTWARE, SOURCE = "Software", "Source"  # keys of the PNG's text
MAKER = f"verify {__version__}"
COLOURS = 128


def write(name: str, content: bytes, *, width: int | None = None, source: str = "") -> None:
    """Write a PNG or JPEG as docs/pictures/NAME.png, at most `width` px wide.

    `source`: a digest of what it shows, where that is cheap to compute again.
    """
    with Image.open(BytesIO(content)) as opened:
        image = opened.convert("RGB")
    if width is not None and image.width > width:
        height = round(image.height * width / image.width)
        image = image.resize((width, height), Image.Resampling.LANCZOS)
    text = PngInfo()
    text.add_text(SOFTWARE, MAKER)
    if source:
        text.add_text(SOURCE, source)
    FOLDER.mkdir(exist_ok=True)
    few_colours(image).save(FOLDER / f"{name}.png", optimize=True, pnginfo=text)
    print(f"docs/pictures/{name}.png")


def few_colours(image: Image.Image) -> Image.Image:
    """Reduce a picture's colours to those that cover it best."""
    method, dither = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
    return image.convert("RGB").quantize(COLOURS, method=method, dither=dither)


def read(path: Path) -> dict[str, str]:
    """Read a picture's stamp: its program and version, the digest of what it shows."""
    with Image.open(path) as image:
        return {key: str(value) for key, value in image.info.items() if key in (SOFTWARE, SOURCE)}


def digest(document: Document) -> str:
    """Digest the words and figures of a report, as printed: rounded, the same on any machine."""
    text = json.dumps(to_template_data(document), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()
