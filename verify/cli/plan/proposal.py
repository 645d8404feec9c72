"""Rigs that do not exist yet: options read, set up before the arm's work, and compared."""

import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from reports.document.formatting import expanded
from reports.plan.summary import rig_lines
from robots import Arm
from verify.cli.terminal import terminal
from verify.core.records import Array
from verify.errors import InputError
from verify.io.files import write_folder_whole
from verify.io.results import refuse_existing
from verify.planning import proposal
from verify.planning.plan import plan_motion
from verify.planning.prediction import joint_levers
from verify.planning.request import PlanningSetup, PlanRequest, SessionConditions
from verify.planning.results import flange_entry

USUAL = {  # where an option is not given: of one rig, and what a table compares
    "--camera": (("1280x720,60deg",), ("640x480,60deg", "1280x720,60deg")),
    "--led": (("4,120mm",), ("4,80mm", "4,160mm")),
    "--baseline": (("0.4",), ("0.2", "0.4")),
    "--distance": (("1.0",), ("0.7", "1.5")),
}
MIN_LENGTH, MAX_LENGTH = 0.02, 20.0  # m, of baseline and distance
MIN_CIRCLE, MAX_CIRCLE = 0.02, 1.0  # m, of the LEDs
MIN_FIELD, MAX_FIELD = 5.0, 150.0  # degrees
MIN_LEDS = 3
RIGS_FILE = "rigs.csv"
REMEDY = "Give a longer --distance, a shorter --baseline, a wider camera, or --near."


def proposed_rigs(
    given: Mapping[str, list[str] | None], assumed: list[str], *, table: bool
) -> list[proposal.ProposedRig]:
    """Combine the values of --camera, --led, --baseline, --distance; assumptions hold for all.

    Raises:
        InputError: a value cannot be used; names its option.
    """
    values = {name: given.get(name) or usual[table] for name, usual in USUAL.items()}
    u = _uncertainties(assumed)
    cameras = [_camera(text) for text in values["--camera"]]
    leds = [_leds(text) for text in values["--led"]]
    baselines, distances = (
        [_length(name, text) for text in values[name]] for name in ("--baseline", "--distance")
    )
    return [
        proposal.ProposedRig(size, field, baseline, distance, count, circle, u)
        for (size, field), (count, circle), baseline, distance in product(
            cameras, leds, baselines, distances
        )
    ]


def propose_setup(
    arm: Arm, rig: proposal.ProposedRig, request: PlanRequest
) -> tuple[PlanningSetup, PlanRequest]:
    """Place a rig before --near, or before a posture that is chosen; the motion stays about it."""
    work = request.near if request.near is not None else proposal.work_posture(arm, request.floor)
    return proposal.build_setup(arm, rig, work, request.floor), replace(request, near=work)


@contextmanager
def describing_remedies() -> Iterator[None]:
    """Say what to describe differently where a rig that can still be moved shows too little."""
    try:
        yield
    except InputError as problem:
        if problem.place != "plan":
            raise
        raise InputError(problem.place, problem.found, problem.expected, REMEDY) from problem


def compare_rigs(
    arm: Arm,
    rigs: list[proposal.ProposedRig],
    request: PlanRequest,
    conditions: SessionConditions,
    out: Path | None,
    *,
    force: bool,
) -> None:
    """Plan a motion for each rig and print a row each; `out` None: nothing is written.

    Raises:
        InputError: `out` is taken, or none of the rigs can be used.
    """
    if out is not None:
        refuse_existing(out, force=force)
    rows: list[dict[str, str | float | None]] = []
    problems: list[InputError] = []
    with terminal.progress("rigs") as progress:
        for done, rig in enumerate(rigs):
            progress(done, len(rigs))
            try:
                with describing_remedies():
                    rows.append(_row(arm, rig, request, conditions))
            except InputError as problem:
                problems.append(problem)
                rows.append({**_describe(rig)})
                terminal.warn(f"{', '.join(_describe(rig).values())}: {problem}")
        progress(len(rigs), len(rigs))
    if len(problems) == len(rigs):
        raise problems[0]
    terminal.say(*rig_lines(rows, arm.dof))
    for row in rows:
        terminal.record("rig", **row)
    if out is not None:
        with write_folder_whole(out, force) as folder:
            pd.DataFrame(rows).to_csv(folder / RIGS_FILE, index=False, float_format="%.6g")
        terminal.say(f"Written: {out / RIGS_FILE}")


def _row(
    arm: Arm, rig: proposal.ProposedRig, request: PlanRequest, conditions: SessionConditions
) -> dict[str, str | float | None]:
    """Expanded uncertainties, k = 2, of the best motion for a rig."""
    setup, request = propose_setup(arm, rig, request)
    predicted = plan_motion(setup, request, conditions, lambda *_: None).prediction
    flange = flange_entry(predicted.session)
    row: dict[str, str | float | None] = {
        **_describe(rig),
        "flange_mm": expanded(flange["standard_uncertainty_mm"]),
        "flange_deg": expanded(flange["standard_uncertainty_deg"]),
    }
    levers = joint_levers(predicted.session)
    spread: Array = np.sqrt(np.diag(predicted.analysis.resolved.mean_covariance))
    for j, (u, lever) in enumerate(zip(spread.tolist(), levers.tolist(), strict=True)):
        known = expanded(u)
        joint = f"q{j + 1}"
        row[f"{joint}_deg"] = None if known is None else math.degrees(known)
        row[f"{joint}_mm"] = None if known is None else known * lever * 1e3
    return row


def _describe(rig: proposal.ProposedRig) -> dict[str, str]:
    width, height = rig.image_size
    return {
        "camera": f"{width}x{height}, {math.degrees(rig.field_of_view):g}°",
        "leds": f"{rig.leds}, {rig.led_circle * 1e3:g} mm",
        "baseline": f"{rig.baseline:g} m",
        "distance": f"{rig.distance:g} m",
    }


def _camera(text: str) -> tuple[tuple[int, int], float]:
    parts = re.fullmatch(r"\s*(\d{2,5})\s*[xX×]\s*(\d{2,5})\s*,\s*([0-9.]+)\s*(?:deg|°)?\s*", text)
    field = _number(parts[3]) if parts else math.nan
    if parts is None or not MIN_FIELD <= field <= MAX_FIELD:
        raise InputError(
            "--camera", f'"{text}"',
            "columns x rows and the horizontal field of view are expected, "
            f"{MIN_FIELD:g}° to {MAX_FIELD:g}°", "Example: --camera 1280x720,60deg",
        )  # fmt: skip
    return (int(parts[1]), int(parts[2])), math.radians(field)


def _leds(text: str) -> tuple[int, float]:
    parts = re.fullmatch(r"\s*(\d{1,2})\s*,\s*([0-9.]+)\s*mm\s*", text)
    count = int(parts[1]) if parts else 0
    circle = _number(parts[2]) * 1e-3 if parts else math.nan
    if not (MIN_LEDS <= count <= proposal.MAX_LEDS and MIN_CIRCLE <= circle <= MAX_CIRCLE):
        raise InputError(
            "--led", f'"{text}"',
            f"{MIN_LEDS} to {proposal.MAX_LEDS} LEDs and the diameter of their circle are "
            f"expected, {MIN_CIRCLE * 1e3:g} to {MAX_CIRCLE * 1e3:g} mm", "Example: --led 4,120mm",
        )  # fmt: skip
    return count, circle


def _length(option: str, text: str) -> float:
    """Read metres, or a length with its unit; m."""
    parts = re.fullmatch(r"\s*([0-9.]+)\s*(m|mm)?\s*", text)
    value = _number(parts[1]) * (1e-3 if parts[2] == "mm" else 1.0) if parts else math.nan
    if not MIN_LENGTH <= value <= MAX_LENGTH:
        raise InputError(
            option, f'"{text}"', f"a length of {MIN_LENGTH:g} to {MAX_LENGTH:g} m is expected",
            f"Example: {option} 0.4 (metres) or {option} 400mm",
        )  # fmt: skip
    return value


def _uncertainties(words: list[str]) -> dict[str, float]:
    """Replace typical standard uncertainties by NAME=VALUE; 0: taken as exact."""
    typical, values = proposal.TYPICAL_UNCERTAINTIES, dict[str, float]()
    for word in words:
        name, _, number = word.partition("=")
        value = _number(number)
        if name not in typical or not (math.isfinite(value) and value >= 0):
            raise InputError(
                "--assume", f'"{word}"',
                f"NAME=VALUE is expected, a value at or above 0, a name of {', '.join(typical)}",
                "Example: --assume base_position_mm=0.2",
            )  # fmt: skip
        if name in values:
            raise InputError("--assume", f"{name} is given twice", "one value", "Leave one out.")
        values[name] = value
    return typical | values


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
