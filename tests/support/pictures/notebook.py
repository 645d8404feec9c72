"""The notebook of the documents, executed: its outputs are what its cells print."""

from base64 import b64decode, b64encode
from io import BytesIO

import nbformat
from nbclient import NotebookClient
from PIL import Image

from tests.support.pictures import stamp

PAGE = stamp.ROOT / "docs" / "notebook.ipynb"
TIMEOUT = 600  # s, of a cell
PNG = "image/png"


def executed() -> str:
    """Run every cell in the repository's folder; the notebook's text with its outputs.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell raises.
    """
    notebook = nbformat.read(PAGE, as_version=4)
    place = {"metadata": {"path": str(stamp.ROOT)}}
    NotebookClient(notebook, timeout=TIMEOUT, record_timing=False, resources=place).execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if PNG in data:
                data[PNG] = smaller(data[PNG])
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"], "verify": stamp.MAKER}
    return nbformat.writes(notebook) + "\n"


def smaller(encoded: str) -> str:
    """A PNG in base64 with few colours."""
    with Image.open(BytesIO(b64decode(encoded))) as opened:
        few = stamp.few_colours(opened)
    buffer = BytesIO()
    few.save(buffer, format="png", optimize=True)
    return b64encode(buffer.getvalue()).decode()


def texts(notebook: str) -> list[str]:
    """What the cells of a notebook print and show, as text; pictures apart."""
    found = []
    for cell in nbformat.reads(notebook, as_version=4).cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            shown = data.get("text/html", data.get("text/plain", output.get("text", "")))
            found += [] if PNG in data else [shown]
    return found
