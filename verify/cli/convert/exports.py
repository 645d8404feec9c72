"""Write a session or results for another program."""

from pathlib import Path

from verify.cli.terminal import terminal
from verify.errors import InputError
from verify.io.export.content import ExportContent, read_content, require_poses
from verify.io.export.tables import FOLDERS, write_mat
from verify.io.files import require_apart, write_file_whole, write_folder_whole
from verify.io.results import refuse_file

FILES = ("mat", "mcap", "rrd")


def convert_out(source: Path, out: Path, to: str | None, *, force: bool) -> None:
    """Write what a folder holds in a format, by its name or by the ending of `out`.

    Raises:
        InputError: the folder is damaged, lacks what the format shows, or `out` cannot be written.
    """
    kind = to or out.suffix.removeprefix(".")
    if kind not in (*FOLDERS, *FILES):
        expected = f"--to is one of {', '.join((*FOLDERS, *FILES))}"
        remedy = "Give --to, or let -o end with .mat, .mcap or .rrd."
        raise InputError("-o", f"{out} does not say the format", expected, remedy)
    require_apart(out, source)
    if kind in FILES:
        refuse_file(out, force=force)
    content = read_content(source)
    if kind in ("tum", "mcap", "rrd"):  # what shows readings and pictures on one clock
        terminal.warn(*content.notes)
    if kind == "tum":
        require_poses(content, source)
    if kind in FOLDERS:
        with write_folder_whole(out, force) as folder:
            FOLDERS[kind](content, folder)
            written = sorted(path.name for path in folder.iterdir())
    else:
        with write_file_whole(out) as path:
            _write_file(content, kind, path)
        written = [out.name]
    terminal.say(f"{out}: {', '.join(written)}")
    terminal.record({"type": "result", "out": str(out), "format": kind, "files": written})


def _write_file(content: ExportContent, kind: str, path: Path) -> None:
    if kind == "mat":
        write_mat(content, path)
        return
    with terminal.progress("messages") as progress:
        if kind == "mcap":
            from verify.io.export.mcap import write_mcap

            write_mcap(content, path, progress)
            return
        from verify.io.export.rrd import write_rrd

        write_rrd(content, path, progress)
