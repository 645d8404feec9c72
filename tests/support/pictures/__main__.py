"""Make the pictures of the documents anew: `make pictures`, or some of them by their names."""

import sys
import tempfile
from pathlib import Path

from tests.bench import store
from tests.support.pictures import (
    first_page,
    gallery,
    growth,
    notebook,
    rig_drawing,
    stamp,
    tutorial,
)
from verify import analyse, open_session

SAMPLE = stamp.ROOT / "sample_sessions" / "multi_joint_fault_6r"
PIXELS_PER_INCH = 110  # an A4 page a little wider than a README's column: its small print is read


def make_report() -> None:
    """Measure the sample and draw its report's first page."""
    laid_out = first_page.document(analyse(open_session(SAMPLE)))
    page = first_page.first_page(laid_out, PIXELS_PER_INCH)
    stamp.write("report", page, source=stamp.digest(laid_out))


def main(names: list[str]) -> None:
    """Make the pictures of these names, all without a name, and the gallery's page."""
    wanted = names or ["setup", "report", "tutorial", "notebook", *gallery.NAMES]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if "setup" in wanted:
            stamp.write("setup", rig_drawing.rig_drawing(open_session(SAMPLE)))
        if "report" in wanted:
            make_report()
        if "growth" in names or (not names and store.FILE.is_file()):  # from what make bench keeps
            stamp.write("growth", growth.growth())
        if "tutorial" in wanted:
            tutorial.make(folder)
        if "notebook" in wanted:
            notebook.PAGE.write_text(notebook.executed())
        gallery.make(folder, [name for name in gallery.NAMES if name in wanted])
    gallery.PAGE.write_text(gallery.page(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
