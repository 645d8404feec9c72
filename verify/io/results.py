"""Results as a user of Python has them, and the folder that keeps them with their reports.

What `Results` shows is what the report says, taken from the same places: the verdict's words and
the figures are those of `reports`, which is loaded when one of them is first asked for.
"""

import errno
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

import pandas as pd

import reports
from reports.results import MANIFEST, to_json_value
from verify.errors import InputError
from verify.io import files
from verify.io.series import ALARMS
from verify.io.session.folder import SESSION_FILE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from reports.document.blocks import Verdict

RESULTS = "results"
REPORT_FILES = (
    f"{RESULTS}/{MANIFEST}", "report.html", "report.pdf", "summary.json", "frames.csv", ALARMS,
)  # fmt: skip
RECORDED_TABLES = (SESSION_FILE, "board.toml")  # of a session, of pictures of a board
JOINT_COLUMNS = (  # of a joint's entry in summary.json, in the order of `joints`
    "mean_error_deg", "expanded_uncertainty_deg", "coverage_factor", "worst_error_deg",
    "worst_error_standard_uncertainty_deg", "tolerance_deg", "conformance_probability", "verdict",
    "reason", "minimum_detectable_error_deg", "minimum_separable_error_deg", "pairs",
)  # fmt: skip
CAUSE_COLUMNS = ("kind", "joint", "value", "unit", "expanded_uncertainty", "t_s", "explains")
MAX_FILM_BYTES = 10_000_000  # of a film that is read for a report


def refuse_existing(out: Path, *, force: bool) -> None:
    """Raise InputError, before hours of work, if results cannot be written to the folder `out`.

    It is a file, a session, not empty (unless `force`), holds a folder of the name of a file of a
    report or the other way round, or the system refuses it.
    """
    refuse_session(out)
    files.require_vacant(out, force=force)
    files.refuse_obstacles(out, REPORT_FILES)


def refuse_session(out: Path) -> None:
    """Raise InputError if the folder `out` is a session, whose files results would replace."""
    with files.refused_as_input_error(out):
        there = (out / SESSION_FILE).exists()
    if there:
        expected = "results stand apart from recordings"
        found = f"is a session, with a {SESSION_FILE}"
        raise InputError(out, found, expected, "Choose another -o.")


def refuse_file(path: Path, *, force: bool, read: Iterable[Path | None] = ()) -> None:
    """Raise InputError, before hours of work, if `path` cannot be written or, unless `force`, is.

    Its folder is missing, it is a folder itself, or one of the files and folders that are `read`.
    A rig or marker inside such a folder may be replaced.
    """
    if not path.parent.is_dir():
        raise files.output_refusal(path, OSError(errno.ENOENT, os.strerror(errno.ENOENT)))
    with files.refused_as_input_error(path):
        folder, there = path.is_dir(), path.exists() or files.real_path(path).exists()
    if folder:
        raise InputError(path, "is a folder", "a file is expected", "Choose another name.")
    if there and not force:
        remedy = "Choose another name, or give --force."
        raise InputError(path, "exists", "existing files are not overwritten", remedy)
    setup = path.suffix == ".toml" and path.name not in RECORDED_TABLES
    for source in filter(None, read if there else ()):
        if not (setup and source.is_dir()):
            files.require_apart(path, source)


def write_report_folder(
    results: reports.Results, out: Path, *, force: bool, frames: bool = False
) -> None:
    """Write reports, summary.json and what they are rendered from.

    With `frames` frames.csv too, and alarms.csv of a watched run.

    Raises:
        InputError: the folder cannot be written; nothing is left of it then.
    """
    results = replace(results, summary=to_json_value(results.summary))
    with files.write_folder_whole(out, force) as folder:
        try:
            reports.write(results, folder / RESULTS)
        except reports.ReportError as error:
            if isinstance(error.__cause__, OSError):  # such as a full disk: `files` words it
                raise error.__cause__ from None
            raise
        text = json.dumps(results.summary, indent=2, ensure_ascii=False, allow_nan=False)
        (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
        write_reports(_with_film(results, out), folder)  # a grab wrote it to `out` before
        if frames:
            path, table = folder / "frames.csv", results.tables["frames"]
            table.to_csv(path, index=False, float_format="%.6f", lineterminator="\n")
            if "alarms" in results.tables:
                alarms = results.tables["alarms"].astype({"joint": "Int64"})
                alarms.to_csv(folder / ALARMS, index=False, lineterminator="\n")


def write_reports(results: reports.Results, folder: Path, name: str = "report") -> None:
    """Write NAME.html and NAME.pdf."""
    page, pages = reports.render_report(results)
    (folder / f"{name}.html").write_text(page, encoding="utf-8")
    (folder / f"{name}.pdf").write_bytes(pages)


def read_results(out: Path) -> reports.Results:
    """Read what an earlier run left; raises InputError: `out` holds no results, or damaged ones."""
    files.require_folder(out, "the folder of a report is expected", "Name what a command wrote.")
    with files.restated(reports.ReportError):
        return _with_film(reports.read(out / RESULTS), out)


@dataclass(frozen=True, repr=False)
class Results(reports.Results):
    """What `analyse` found in a session, or `open_results` in a folder.

    `summary` is summary.json as a dict, `setup` the rig, the marker and the robot's table, `tables`
    DataFrames by name (frames, resolved, budget, …), `images` PNG bytes. Errors are reading less
    true angle. U is expanded: k = 2, or Student's factor for the same 95.45 % where the
    uncertainty rests on few pairs.
    """

    @property
    def verdict(self) -> str | None:
        """The verdict: conform, nonconform or undecided; None without a tolerance."""
        verdict: str | None = self.summary["verdict"]
        return verdict

    @property
    def sentence(self) -> str:
        """The verdict in words, and what to do, as page one has it."""
        return self._headline().sentence

    @property
    def joints(self) -> pd.DataFrame:
        """One row a joint, numbered from 1: error, U, tolerance, verdict; NaN: not determined.

        `mean_error_deg` with `expanded_uncertainty_deg` (`coverage_factor` times the standard one);
        `worst_error_deg`, the largest over the session, with `worst_error_expanded_uncertainty_deg`
        (the same factor).
        """
        entries = self.summary["joints"]
        table = pd.DataFrame(
            {name: [entry[name] for entry in entries] for name in JOINT_COLUMNS},
            index=pd.Index([entry["joint"] for entry in entries], name="joint"),
        )
        figures = [name for name in JOINT_COLUMNS if name not in ("verdict", "reason", "pairs")]
        table[figures] = table[figures].astype(float)
        standard = "worst_error_standard_uncertainty_deg"
        table[standard] *= table["coverage_factor"].fillna(2.0)
        return table.rename(columns={standard: "worst_error_expanded_uncertainty_deg"})

    @property
    def causes(self) -> pd.DataFrame:
        """One row a cause that the data single out: what it is, ± U, and what to do about it.

        `finding` and `remedy` are the report's words. Of an `ambiguous` row the candidates are in
        `finding`; `summary["diagnosis"]` has their figures.
        """
        from reports.session import causes
        from reports.session.times import from_first_pair

        entries = self.summary["diagnosis"]
        told = from_first_pair(self).summary["diagnosis"]
        rows = [{name: entry.get(name) for name in CAUSE_COLUMNS} for entry in entries]
        table = pd.DataFrame(rows, columns=list(CAUSE_COLUMNS)).astype({"joint": "Int64"})
        ambiguous = [entry["kind"] == "ambiguous" for entry in entries]
        table["finding"] = [
            causes.rivals(entry, " or ") if several else causes.finding(entry)
            for entry, several in zip(told, ambiguous, strict=True)
        ]
        table["remedy"] = [causes.remedy(entry) for entry in told]
        return table

    @property
    def plots(self) -> tuple[str, ...]:
        """The names that `plot` takes: the report's figures for which there are data."""
        return tuple(reports.charts(self))

    def plot(self, name: str = "overview") -> "Figure":
        """Draw one of the report's figures with matplotlib; InputError: there is none of the name.

        `Figure.savefig` writes it; in a notebook it shows after `%matplotlib inline`.
        """
        charts = reports.charts(self)
        if name not in charts:
            expected = f"this session has {', '.join(charts)}"
            raise InputError("plot", f'there is no figure "{name}"', expected)
        return reports.draw(charts[name])

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write what `verify run -o` writes: reports, summary.json, frames.csv, results.

        `force`: write into a folder that exists and is not empty.

        Raises:
            InputError: it exists, or cannot be written; nothing is left half-written.
        """
        refuse_existing(Path(folder), force=force)
        write_report_folder(self, Path(folder), force=force, frames=True)

    def __str__(self) -> str:
        verdict = self._headline()
        return f"{verdict.label}: {verdict.sentence}"

    def __repr__(self) -> str:
        pairs, session = self.summary["pairs"], self.summary["session"]
        counted = f"{pairs['measured']} of {pairs['recorded']} pairs"
        name = Path(session["path"]).name
        return f"<Results of {name}: {self.verdict or 'no tolerance'}, {counted} measured>"

    def _repr_html_(self) -> str:
        """Show verdict, joints and conditions in a notebook."""
        from reports.session.notebook import fragment

        return fragment(self, self.joints)

    def _headline(self) -> "Verdict":
        from reports.session.headline import headline

        return headline(self)


def open_results(folder: str | Path) -> Results:
    """Open what `verify run -o` or `Results.save` wrote.

    Raises:
        InputError: it holds no results, damaged ones, or those of another command.
    """
    read = read_results(Path(folder))
    kind = read.summary.get("kind", "run")
    if kind != "run":
        found = f"holds the results of another command ({kind})"
        remedy = "Name a folder that `verify run` wrote."
        raise InputError(Path(folder) / RESULTS, found, "results of a session are expected", remedy)
    return Results(read.summary, read.setup, read.tables, read.images)


def _with_film(results: reports.Results, folder: Path) -> reports.Results:
    """Take along the film that lies beside a report, if there is one and it is no giant."""
    name = results.summary.get("film")
    if not isinstance(name, str) or PurePath(name).name != name:
        return results
    film = folder / name
    try:
        if film.is_file() and film.stat().st_size <= MAX_FILM_BYTES:
            return replace(results, films={name: film.read_bytes()})
    except OSError:
        pass  # the report says where it should lie
    return results
