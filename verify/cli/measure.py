"""Measure recorded sessions: results, verdict, and a report on each."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reports import Results
from reports.document.formatting import with_uncertainty
from reports.session.headline import headline
from verify.analysis.session import analyse
from verify.cli.options import ToleranceOptions
from verify.cli.terminal import report_files, terminal
from verify.errors import InputError
from verify.io.results import refuse_existing, write_report_folder
from verify.io.session.session import open_session


def measure_and_report(
    folder: Path,
    out: Path | None,
    tolerances: ToleranceOptions,
    *,
    force: bool,
    warnings: tuple[str, ...] = (),
    rig: Path | None = None,
    marker: Path | None = None,
) -> str | None:
    """Measure a session, write its reports, print the results; the verdict, None without tolerance.

    `out` None is NAME-report in the current folder; `tolerances` replace the session's; `force`:
    write into a folder that exists; `warnings`: of the watch, for the report. alarms.csv of a
    recording is on page one. `rig` and `marker` replace the session's own.

    Raises:
        InputError: the session cannot be measured, or the reports cannot be written.
    """
    session = open_session(folder, rig=rig, marker=marker)
    target = out if out is not None else Path(f"{session.name}-report")
    refuse_existing(target, force=force)
    terminal.warn(*session.warnings)
    tolerance = tolerances.tolerance(session.arm.dof)
    with terminal.progress("pairs") as progress:
        results = analyse(session, tolerance=tolerance, progress=progress)
    results.summary["warnings"] = [*warnings, *results.summary["warnings"]]
    terminal.warn(*(w for w in results.summary["warnings"] if w not in session.warnings))
    write_report_folder(results, target, force=force, frames=True)
    _print_summary(results, target)
    verdict: str | None = results.summary["verdict"]
    return verdict


def measure_and_report_all(
    folders: Sequence[Path],
    out: Path,
    tolerances: ToleranceOptions,
    *,
    force: bool,
    warnings: tuple[str, ...] = (),
) -> dict[Path, str | None]:
    """Measure the sessions of one live run, a report each; an unmeasurable one is left out.

    More than one, in order, where the controller's clock began anew. `out` is the first one's
    report, with the `warnings` of the watch; the others' have a number behind it. Gives the verdict
    of each report, at least one.

    Raises:
        InputError: none can be measured: what the first one lacks.
    """
    verdicts: dict[Path, str | None] = {}
    refusals: list[InputError] = []
    for number, folder in enumerate(folders, start=1):
        target = out if number == 1 else out.with_name(f"{out.name}-{number}")
        try:
            verdicts[target] = measure_and_report(
                folder, target, tolerances, force=force, warnings=() if verdicts else warnings
            )
        except InputError as refusal:
            refusals.append(refusal)
    if not verdicts:
        terminal.warn(*warnings)  # no report says them
        raise refusals[0]
    terminal.warn(*map(str, refusals))
    return verdicts


def _print_summary(results: Results, target: Path) -> None:
    """Print verdict and joints; the report has the rest."""
    summary: dict[str, Any] = results.summary
    verdict = headline(results)
    terminal.say(f"{verdict.label}: {verdict.sentence}")
    terminal.say(*map(_joint_line, summary["joints"]))
    for largest in summary["budget"]["unstated"][:1]:
        terminal.say(f"  not counted: {largest['source']}: {largest['text']}")
    terminal.detail(*_verbose_lines(summary))
    terminal.say(f"Report: {report_files(target)}")
    terminal.record("result", out=str(target), summary=summary)


def _verbose_lines(summary: dict[str, Any]) -> list[str]:
    """What --verbose adds: pairs, clock, how LEDs were told apart, detectable errors."""
    pairs, clock = summary["pairs"], summary["clock"]
    lost = ", ".join(f"{n} {status}" for status, n in pairs["rejected"].items()) or "none"
    offset = clock["encoder_offset_s"]
    source = "not shown by the motion" if offset is None else f"{offset:+.6f} s, {clock['source']}"
    choices = ", ".join(f"{n} by {how}" for how, n in summary["choices"].items()) or "-"
    smallest = [j["minimum_detectable_error_deg"] for j in summary["joints"]]
    shown = ", ".join("-" if s is None else f"{s:.3f}°" for s in smallest)
    return [
        f"pairs: {pairs['measured']} of {pairs['recorded']} measured; rejected: {lost}",
        f"encoder clock: {source}",
        f"LEDs identified: {choices}",
        f"smallest detectable offset of each joint: {shown}",
    ]


def _joint_line(joint: dict[str, Any]) -> str:
    mean, u = joint["mean_error_deg"], joint["expanded_uncertainty_deg"]
    error = "not determined"
    if mean is not None:
        error = f"{with_uncertainty(mean, u, '°')} (k = {joint['coverage_factor'] or 2.0:.3g})"
    verdict = "" if joint["verdict"] is None else f"  {joint['verdict']}"
    return f"  joint {joint['joint']}: {error}{verdict}"
