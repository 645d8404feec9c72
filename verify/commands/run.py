"""Measure a recorded session, compare it with the encoders, judge, and write the reports."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from verify.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from reports import Results
    from verify.session import Session, Tolerance

STATUS = {"conform": 0, None: 0, "nonconform": 1, "undecided": 3}


def run(
    source: Annotated[Path, typer.Argument(help="A recorded session's folder.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where to; default: NAME-report, here.")
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(help="Joint errors allowed, degrees: one number, or one a joint: 0.2,0.2,…"),
    ] = None,
    position_tolerance: Annotated[
        float | None, typer.Option(help="Position error allowed, mm.")
    ] = None,
    orientation_tolerance: Annotated[
        float | None, typer.Option(help="Orientation error allowed, degrees.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write into a folder that exists.")
    ] = False,
) -> int:
    """Measure a recorded session, compare with the encoders, judge, report.

    Exit status 0: ran, conforms where a verdict was asked for; 1: does not conform; 2: could not
    run; 3: undecided.

    Example: verify run sample_sessions/multi_joint_fault_6r --tolerance 0.2
    """
    from verify.analysis import analyse
    from verify.results_folder import refuse_existing, write_results
    from verify.session import open_session

    session = open_session(source)
    target = out if out is not None else Path(f"{session.name}-report")
    refuse_existing(target, force=force)
    for warning in session.warnings:
        terminal.warn(warning)
    asked = _tolerance(session, tolerance, position_tolerance, orientation_tolerance)
    with terminal.progress("pairs") as progress:
        results = analyse(session, tolerance=asked, progress=progress)
    for warning in results.summary["warnings"]:
        if warning not in session.warnings:
            terminal.warn(warning)
    write_results(results, target, force=force)
    _say(results, target)
    return STATUS[results.summary["verdict"]]


def _tolerance(
    session: "Session",
    joints: str | None,
    position_mm: float | None,
    orientation_deg: float | None,
) -> "Tolerance":
    import numpy as np

    from verify.session import Tolerance

    given = None if joints is None else np.deg2rad(_numbers(joints, session.arm.dof))
    for name, value in (
        ("--position-tolerance", position_mm),
        ("--orientation-tolerance", orientation_deg),
    ):
        if value is not None:
            _require_positive(name, value)
    return Tolerance(
        joints=given,
        position=None if position_mm is None else position_mm * 1e-3,
        orientation=None if orientation_deg is None else float(np.deg2rad(orientation_deg)),
    )


def _numbers(text: str, joints: int) -> list[float]:
    from verify.errors import InputError

    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        raise InputError(
            "--tolerance", f'"{text}" is not a number of degrees',
            f"one number is asked for, or {joints} with commas between", "Example: 0.2",
        ) from None  # fmt: skip
    for value in values:
        _require_positive("--tolerance", value)
    if len(values) == 1:
        values = values * joints
    if len(values) != joints:
        raise InputError(
            "--tolerance", f"{len(values)} numbers were given",
            f"the robot has {joints} joints", "Give one number, or one a joint.",
        )  # fmt: skip
    return values


def _require_positive(name: str, value: float) -> None:
    import math

    from verify.errors import InputError

    if not (math.isfinite(value) and value > 0):
        raise InputError(name, f"{value:g} was given", "a tolerance is greater than 0", "")


def _say(results: "Results", target: Path) -> None:
    """Tell what was found, briefly; the report has the rest."""
    from reports.headline import headline

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
