"""Write and read a report folder: reports, summary.json, and the tables they are rendered from."""

import errno
import json
import os
from pathlib import Path

import reports
from reports import ReportError, Results
from reports.results import to_json_value
from verify.errors import InputError
from verify.io.files import output_refusal, real_path, write_folder_whole

RESULTS = "results"


def refuse_existing(out: Path, *, force: bool) -> None:
    """Raise InputError, before hours of work, if `out` is a file or, unless `force`, not empty."""
    real_path(out)
    if out.is_file() or (out.is_dir() and any(out.iterdir()) and not force):
        found = "is a file" if out.is_file() else "exists and is not empty"
        raise InputError(out, found, "results need a folder of their own",
                         "Choose another with -o, or give --force.")  # fmt: skip


def refuse_file(path: Path, *, force: bool) -> None:
    """Raise InputError, before hours of work, if `path` cannot be written or, unless `force`, is.

    Its folder is missing, or it is a folder itself.
    """
    if not path.parent.is_dir():
        raise output_refusal(path, OSError(errno.ENOENT, os.strerror(errno.ENOENT)))
    if real_path(path).is_dir():
        raise InputError(path, "is a folder", "a file is expected", "Choose another name.")
    if path.exists() and not force:
        remedy = "Choose another name, or give --force."
        raise InputError(path, "exists", "existing files are not overwritten", remedy)


def write_report_folder(results: Results, out: Path, *, force: bool, frames: bool = False) -> None:
    """Write reports, summary.json and what they are rendered from; with `frames` frames.csv too.

    Raises:
        InputError: the folder cannot be written; nothing is left of it then.
    """
    with write_folder_whole(out, force) as folder:
        try:
            reports.write(results, folder / RESULTS)
        except ReportError as error:
            if isinstance(error.__cause__, OSError):  # such as a full disk: `files` words it
                raise error.__cause__ from None
            raise
        summary = to_json_value(results.summary)
        text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
        write_reports(results, folder)
        if frames:
            table = results.tables["frames"]
            table.to_csv(
                folder / "frames.csv", index=False, float_format="%.6f", lineterminator="\n"
            )


def write_reports(results: Results, folder: Path) -> None:
    """Write report.html and report.pdf."""
    (folder / "report.html").write_text(reports.render_html(results), encoding="utf-8")
    (folder / "report.pdf").write_bytes(reports.render_pdf(results))


def read_results(out: Path) -> Results:
    """Read what an earlier run left; raises InputError: `out` holds no results, or damaged ones."""
    try:
        return reports.read(out / RESULTS)
    except ReportError as error:
        raise InputError(error.place, error.found, error.expected, error.remedy) from error
