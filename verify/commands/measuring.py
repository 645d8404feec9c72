"""One recorded session: measured, judged, reported; the end of every `verify run`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from reports import Results
from reports.headline import headline
from verify.analysis import analyse
from verify.commands.asked import Asked
from verify.errors import InputError
from verify.results_folder import refuse_existing, write_results
from verify.session import open_session
from verify.terminal import terminal


def measure_recorded(folder: Path, out: Path | None, asked: Asked, *, force: bool) -> str | None:
    """Measure a session, write its reports, say what was found.

    Args:
        folder: the session.
        out: where the reports go; None: NAME-report in the current folder.
        asked: tolerances that replace the session's.
        force: write into a folder that exists.

    Returns:
        The verdict; None where no tolerance was asked for.

    Raises:
        InputError: the session cannot be measured, or the reports cannot be written.
    """
    session = open_session(folder)
    target = out if out is not None else Path(f"{session.name}-report")
    refuse_existing(target, force=force)
    for warning in session.warnings:
        terminal.warn(warning)
    tolerance = asked.tolerance(session.arm.dof)
    with terminal.progress("pairs") as progress:
        results = analyse(session, tolerance=tolerance, progress=progress)
    for warning in results.summary["warnings"]:
        if warning not in session.warnings:
            terminal.warn(warning)
    write_results(results, target, force=force)
    _say(results, target)
    verdict: str | None = results.summary["verdict"]
    return verdict


def measure_parts(
    folders: Sequence[Path], out: Path, asked: Asked, *, force: bool
) -> dict[Path, str | None]:
    """Measure the sessions of one live run, a report each; one that cannot be is no other's harm.

    Args:
        folders: in their order: more than one where the controller's clock began anew.
        out: the first one's report; the others' have a number behind it.
        asked: as for `measure_recorded`.
        force: likewise.

    Returns:
        The verdict of each report, at least one.

    Raises:
        InputError: none can be measured: what the first one lacks.
    """
    verdicts: dict[Path, str | None] = {}
    refusals: list[InputError] = []
    for number, folder in enumerate(folders, start=1):
        target = out if number == 1 else out.with_name(f"{out.name}-{number}")
        try:
            verdicts[target] = measure_recorded(folder, target, asked, force=force)
        except InputError as refusal:
            refusals.append(refusal)
    if not verdicts:
        raise refusals[0]
    for left_out in refusals:
        terminal.warn(str(left_out))
    return verdicts


def _say(results: Results, target: Path) -> None:
    """Tell what was found, briefly; the report has the rest."""
    summary: dict[str, Any] = results.summary
    verdict = headline(results)
    terminal.say(f"{verdict.label}: {verdict.sentence}")
    for joint in summary["joints"]:
        terminal.say(_line(joint))
    for line in _details(summary):
        terminal.detail(line)
    terminal.say(f"Report: {target / 'report.html'} and {target / 'report.pdf'}")
    terminal.record({"type": "result", "out": str(target), "summary": summary})


def _details(summary: dict[str, Any]) -> list[str]:
    """What --verbose adds: pairs, clock, how LEDs were told apart, detectable errors."""
    pairs, clock = summary["pairs"], summary["clock"]
    lost = ", ".join(f"{n} {status}" for status, n in pairs["rejected"].items()) or "none"
    offset = clock["encoder_offset_s"]
    said = "not shown by the motion" if offset is None else f"{offset:+.6f} s, {clock['source']}"
    told = ", ".join(f"{n} by {how}" for how, n in summary["choices"].items()) or "-"
    smallest = [j["minimum_detectable_error_deg"] for j in summary["joints"]]
    shown = ", ".join("-" if s is None else f"{s:.3f}°" for s in smallest)
    return [
        f"pairs: {pairs['measured']} of {pairs['recorded']} measured; rejected: {lost}",
        f"encoder clock: {said}",
        f"LEDs told apart: {told}",
        f"smallest offset that would be noticed, a joint: {shown}",
    ]


def _line(joint: dict[str, Any]) -> str:
    mean, u = joint["mean_error_deg"], joint["expanded_uncertainty_deg"]
    error = "not determined" if mean is None else f"{mean:+.3f}°"
    doubt = "" if u is None else f" ± {u:.3f}°"
    verdict = "" if joint["verdict"] is None else f"  {joint['verdict']}"
    return f"  joint {joint['joint']}: {error}{doubt}{verdict}"
