"""Identify an arm's own parameters from sessions; write the corrected arm and its report."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from reports import Results
from reports.document.formatting import decimals_of, number, with_uncertainty
from verify.analysis.instrument import BODY_SOURCE, CALIBRATION_SOURCE
from verify.calibration.kinematics import results
from verify.calibration.kinematics import sessions as arm_sessions
from verify.calibration.kinematics.chain import chain_of
from verify.calibration.kinematics.fit import pose_residuals
from verify.calibration.kinematics.identify import (
    LEVELS,
    IdentificationOptions,
    IdentificationResult,
    identify_arm,
    register,
    unstated_effects,
)
from verify.calibration.kinematics.mistakes import refuse_mistaken_readings, refuse_unfit
from verify.calibration.kinematics.placements import session_files
from verify.calibration.kinematics.robot_file import encode_robot
from verify.calibration.origin import ResultsOrigin
from verify.cli.terminal import report_files, terminal
from verify.core.version import __version__
from verify.errors import InputError, one_line
from verify.io.files import write_folder_whole
from verify.io.results import refuse_existing, write_report_folder
from verify.io.session.session import Session, open_session

MIN_POSES = 6  # of a base and a tool: fewer determine neither, and nothing could be held out


def identify_sessions(
    folders: Sequence[Path],
    out: Path | None,
    options: IdentificationOptions,
    free_base: bool | None,
    free_tool: bool | None,
    *,
    judges: Sequence[Path] = (),
    force: bool,
) -> None:
    """Identify the arm of some sessions; write its robot file, parameters.csv and the reports.

    `out` None is NAME-identification in the current folder; `force`: it need not be empty. Base and
    tool (the LEDs) at None are free where a rig or marker states that it was found through the
    encoders. `judges` are sessions that validate the identified arm, and are not identified from.

    Raises:
        InputError: a session cannot be used, they are of different arms, or `out` is not vacant.
    """
    opened = [open_session(folder) for folder in folders]
    others = [open_session(folder) for folder in judges]
    arm_sessions.require_one_arm([*opened, *others])
    target = out if out is not None else Path(f"{opened[0].name}-identification")
    refuse_existing(target, force=force)
    registered = not free_base and not free_tool and not any(map(arm_sessions.tool_open, opened))
    gathered = _combine_poses(opened, registered=registered)
    judging = _combine_poses(others, registered=registered) if others else None
    if judging is not None and judging.poses.position_only != gathered.poses.position_only:
        raise InputError(
            others[0].folder, "does not hold what the arm is identified from",
            "poses are checked with poses, positions with positions", "Give another --judge.",
        )  # fmt: skip
    options = replace(
        options,
        free_base=gathered.free_base if free_base is None else free_base,
        free_tool=gathered.free_tool if free_tool is None else free_tool,
    )
    gathered, found = _identify_twice(gathered, options)
    if undetermined := found.levels[0].support.held:
        names = ", ".join(one.parameter.name for one in undetermined)
        raise InputError(
            opened[0].folder / "encoders.csv", f"the motion leaves {names} undetermined",
            "base and target together need turns about two axes that are not parallel",
            "Record a motion of more joints, or hold one: --base held or --leds held.",
        )  # fmt: skip
    held = not (options.free_base and options.free_tool)
    doubts = refuse_unfit(opened[0].folder / "encoders.csv", gathered, found, held=held)
    made_from = _identification_provenance(gathered, options, found, doubts)
    name, content = encode_robot(
        made_from.arm, found.chain, _correction_sentences(found, made_from),
        made_from.origin.inputs, offsets_only=found.chosen.name != "geometry",
    )  # fmt: skip
    judged = None if judging is None else _validate(judging, found, options)
    made = results.identification_results(found, gathered.poses, made_from, name, judged)
    terminal.warn(*made_from.origin.warnings)
    table = made.tables["parameters"].to_csv(index=False, lineterminator="\n")
    with write_folder_whole(target, force) as folder:
        write_report_folder(made, folder, force=True)
        (folder / name).write_bytes(content)
        for path, data in session_files(gathered, found.chosen.fit, name, content):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        (folder / "parameters.csv").write_text(table, encoding="utf-8")
    _print_summary(made, target)


def _combine_poses(sessions: Sequence[Session], *, registered: bool) -> arm_sessions.CombinedPoses:
    measured = []
    for session in (part for whole in sessions for part in arm_sessions.split_targets(whole)):
        with terminal.progress(f"pairs of {session.name}") as progress:
            measured.append(arm_sessions.session_to_poses(session, progress, registered=registered))
    gathered = arm_sessions.gather_sessions(measured)
    places = gathered.poses.base * (int(gathered.poses.tool.max()) + 1) + gathered.poses.tool
    count = np.bincount(places[gathered.poses.first_visits])[np.unique(places)]
    if count.min() < MIN_POSES:
        raise InputError(
            sessions[0].folder, f"{count.min()} different postures with readings",
            f"{MIN_POSES} or more are needed of each placing of robot and LEDs",
            "Record a longer session.",
        )  # fmt: skip
    if not registered:
        refuse_mistaken_readings(sessions[0].folder / "encoders.csv", gathered)
    return gathered


def _validate(
    judging: arm_sessions.CombinedPoses, found: IdentificationResult, options: IdentificationOptions
) -> results.ValidationSessions:
    """Register other sessions anew, with the arm as its file has it and with the identified one."""
    rows, arm = judging.poses, chain_of(judging.sessions[0].session.arm)
    left = []
    for chain in (arm, found.chain):
        known = None if options.free_base and options.free_tool else judging.state(chain)
        left.append(pose_residuals(register(chain, rows, options, known).state, rows))
    return results.ValidationSessions([one.session.name for one in judging.sessions], *left)


def _identify_twice(
    gathered: arm_sessions.CombinedPoses, options: IdentificationOptions
) -> tuple[arm_sessions.CombinedPoses, IdentificationResult]:
    """Identify, and again with a lower weight for pairs that repeat each other's errors."""
    chain = chain_of(gathered.sessions[0].session.arm)
    # with both free no start is needed
    known = None if options.free_base and options.free_tool else gathered.state(chain)
    first = identify_arm(chain, gathered.poses, replace(options, level=LEVELS[0], splits=0), known)
    fewer = arm_sessions.deflate_repetition(gathered, first.richest)
    return fewer, identify_arm(chain, fewer.poses, options, known)


def _identification_provenance(
    gathered: arm_sessions.CombinedPoses,
    options: IdentificationOptions,
    found: IdentificationResult,
    doubts: Sequence[str],
) -> results.IdentificationProvenance:
    sessions = [one.session for one in gathered.sessions]
    several = len(sessions) > 1
    inputs = {
        f"{session.name}/{path}" if several else path: digest
        for session in sessions
        for path, digest in session.inputs.items()
    }
    names = [one_line(session.name) for session in sessions]
    description = sessions[0].description if not several else ""
    warnings = tuple(dict.fromkeys([*doubts, *_warnings(gathered, options, found)]))
    return results.IdentificationProvenance(
        origin=ResultsOrigin(", ".join(names), description, inputs, warnings),
        arm=sessions[0].arm,
        names=names,
        source=gathered.source,
        frame=gathered.frame,
        free_base=options.free_base,
        free_tool=options.free_tool,
    )


def _warnings(
    gathered: arm_sessions.CombinedPoses,
    options: IdentificationOptions,
    found: IdentificationResult,
) -> list[str]:
    warnings = [warning for one in gathered.sessions for warning in one.session.warnings]
    hidden = {
        "robot base": options.free_base,
        "LED body": options.free_tool,
        BODY_SOURCE: options.free_tool,
        "robot table": found.chosen.name == "geometry",
    }
    exact = dict.fromkeys(
        source
        for one in gathered.sessions
        for source in one.uncounted
        if not hidden.get(source, False)
    )
    if exact:
        held = {"robot base": "base", "LED body": "tool", BODY_SOURCE: "tool"}
        scales = [source for source in exact if source in ("rig", CALIBRATION_SOURCE)]
        effects = unstated_effects(
            found.chosen.fit,
            gathered.poses,
            scales,
            {held[source]: source for source in exact if source in held},
        )
        said = "".join(f"; {effect.source}: {effect}" for effect in effects)
        if scales and found.chosen.name == "geometry":
            said += "; a scale that is off makes every length off by as much"
        warnings.append(
            f"No uncertainty is stated for {', '.join(exact)}: taken as exact; the uncertainties "
            f"hold on that condition{said}."
        )
    chosen, best = found.chosen, found.best
    if LEVELS.index(chosen.name) < LEVELS.index(best.name):
        left, least = (one.position[0] * 1e3 for m in (chosen, best) if (one := m.held_out))
        warnings.append(
            f"--model {chosen.name}: {left:.3g} mm are left of poses held out, by {best.name} "
            f"{least:.3g} mm; offsets may be off by more than their U."
        )
    if found.chosen.fit.scatter is None:
        warnings.append(
            "From one recording: how this arm's parameters differ from one recording to the next "
            "is not in the uncertainties. Give two or more sessions."
        )
    return warnings


def _correction_sentences(
    found: IdentificationResult, made_from: results.IdentificationProvenance
) -> list[str]:
    level = found.chosen
    used = int(level.fit.used.sum())
    what = f"{len(level.fit.parameters)} parameters from {used} poses"
    sentences = [
        f"Identified by verify {__version__} from {made_from.origin.source}: {what}.",
        f"Before: {made_from.arm.name}, sha256:{made_from.arm.fingerprint}.",
    ]
    if level.held_out is not None:
        mean = level.held_out.position[0] * 1e3
        sentences.append(f"Mean position residual on poses held out: {mean:.3f} mm.")
    return sentences


def _print_summary(made: Results, target: Path) -> None:
    summary = made.summary
    used = summary["poses"]["used"]
    terminal.say(
        f"{summary['identified']} parameters identified ({summary['level']}) from {used} poses; "
        f"{summary['rank']} of {summary['candidates']} can be told apart"
    )
    terminal.say(*(_joint_line(joint, summary["coverage_factor"]) for joint in summary["offsets"]))
    for level in summary["levels"]:
        if (held := level["held_out"]) is not None:
            terminal.say(f"  held out, {level['name']}: {held['mean_mm']:.3f} mm mean")
    if summary["judged"] is not None:
        before, after = (summary["judged"][key]["mean_mm"] for key in ("before", "after"))
        terminal.say(
            f"  {summary['judged']['path']}: {before:.3f} mm mean, identified {after:.3f} mm"
        )
    outlying = len(summary["poses"]["outlying"])
    if outlying:
        verb = "pose does" if outlying == 1 else "poses do"
        terminal.warn(f"{outlying} {verb} not belong to the others: left out of the fit, listed")
    terminal.say(f"Written: {target / summary['robot_file']}; report: {report_files(target)}")
    terminal.record("result", out=str(target), summary=summary)


def _joint_line(joint: dict[str, float | None], factor: float) -> str:
    add, u = joint["add_to_reading_deg"], joint["expanded_uncertainty_deg"]
    if add is None or u is None:
        return f"  joint {joint['joint']}: offset not identified"
    error = with_uncertainty(-add, u, "°")
    return (
        f"  joint {joint['joint']}: encoder less measured {error} (k = {factor:.3g}); "
        f"add {number(add, decimals_of(u), signed=True)}° to the reading"
    )
