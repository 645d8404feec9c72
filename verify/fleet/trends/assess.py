"""From sessions.parquet and the failures to the results of a fleet report."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import PurePosixPath
from typing import Any

import numpy as np
import pandas as pd

from reports import Results
from verify.core.records import Flags
from verify.core.version import __version__
from verify.errors import InputError
from verify.fleet.batch.records import COPY
from verify.fleet.trends.changes import MIN_SESSIONS
from verify.fleet.trends.joints import (
    CHANGE_COLUMNS,
    MIN_SESSIONS_TO_ASSESS,
    POINT_COLUMNS,
    JointAssessment,
    assess_joint,
    change_rows,
    point_rows,
)
from verify.fleet.trends.series import JointSeries, contrast, series_of

P_FALSE_ALARM = 0.01  # of the whole report: a change, an odd session, a difference; one each
MAX_WORST_SESSIONS = 20  # sessions listed as the worst
ARM_GROUPINGS = ("robot", "folder")  # what tells arms apart
VERDICTS = ("conform", "undecided", "nonconform")
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class TrendRequest:
    """Options of a fleet report."""

    by: str = "robot"  # one of ARM_GROUPINGS
    since: date | None = None  # before and after this day
    compare: tuple[str, str] | None = None  # sessions below one folder against those below another


def assess(
    sessions: pd.DataFrame, failures: pd.DataFrame, request: TrendRequest, reported: Sequence[str]
) -> Results:
    """Judge a fleet by the rows of sessions.parquet and its failures: results of the kind "fleet".

    The names `reported` are of sessions that have reports of their own.
    """
    sessions = sessions.assign(arm=_arms(sessions, request.by))
    every = [
        series_of(rows, str(arm), joint)
        for arm, rows in sessions.groupby("arm", sort=True)
        for joint in range(1, int(rows["joints"].max()) + 1)
    ]
    # the chance of a false alarm is shared out between all that can be judged
    long = [one for one in every if len(one) >= MIN_SESSIONS_TO_ASSESS]
    chance = P_FALSE_ALARM / max(len(long), 1)
    judged = {(one.arm, one.joint): assess_joint(one, chance) for one in long}
    contrasts = _contrasts(sessions, every, request)
    tables = {
        "arms": pd.DataFrame([_arm_row(str(arm), own) for arm, own in sessions.groupby("arm")]),
        "joints": pd.DataFrame(
            [_joint_row(sessions, one, judged.get((one.arm, one.joint))) for one in every]
        ),
        "changes": pd.DataFrame(
            [row for one in judged.values() for row in change_rows(one)], columns=CHANGE_COLUMNS
        ),
        "recent": pd.DataFrame(_recent_rows(sessions), columns=_RECENT_COLUMNS),
        "points": _points(list(judged.values())),
        "contrasts": pd.DataFrame(contrasts, columns=_CONTRAST_COLUMNS),
        "worst": _worst_sessions(sessions, set(reported)),
        "failures": failures,
    }
    return Results(_summary(sessions, failures, request, every), {}, tables)


_CONTRAST_COLUMNS = [
    "question", "arm", "joint", "first", "second", "first_sessions", "second_sessions",
    "first_deg", "second_deg", "difference_deg", "difference_u_deg", "shown", "unclear",
]  # fmt: skip


def _arms(sessions: pd.DataFrame, by: str) -> pd.Series:
    """Name the arm of each session: its robot and serial number, or that robot and the folder.

    The number where sessions of one robot state several, the folder that holds the session.
    """
    robot, serial = sessions["robot"], sessions["serial_number"]
    if by == "robot":
        several = serial.groupby(robot).transform("nunique") > 1
        return robot.where(serial.isna() | ~several, robot + " no. " + serial.astype(str))
    above = sessions["session"].map(lambda name: PurePosixPath(name).parent.name or ".")
    return robot + " in " + above


def _points(judged: list[JointAssessment]) -> pd.DataFrame:
    tables = [point_rows(one) for one in judged]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=POINT_COLUMNS)


def _arm_row(arm: str, rows: pd.DataFrame) -> dict[str, Any]:
    """How many sessions of an arm there are, by their verdict."""
    counts = {word: int((rows["verdict"] == word).sum()) for word in VERDICTS}
    return {"arm": arm, "sessions": len(rows), "last": _day(rows["started"].max()), **counts}


_MEDIANS = {
    "detectable_deg": "minimum_detectable_error_deg",
    "separable_deg": "minimum_separable_error_deg",
    "visible": "visible_fraction",
    "visible_since": "visible_fraction_since_registration",
}


def _joint_row(
    sessions: pd.DataFrame, series: JointSeries, judged: JointAssessment | None
) -> dict[str, Any]:
    """One row of the table of joints."""
    rows = sessions[sessions["arm"] == series.arm]
    name = f"q{series.joint}"
    verdicts = rows[f"{name}_verdict"].value_counts()
    row: dict[str, Any] = {
        "arm": series.arm,
        "joint": series.joint,
        "sessions": len(series),
        "without_figure": len(rows) - len(series),
        "undated": int(rows["started"].isna().sum()),
        "state": judged.state if judged else "unknown",
        **{word: int(verdicts.get(word, 0)) for word in VERDICTS},
        **{short: rows[f"{name}_{figure}"].median() for short, figure in _MEDIANS.items()},
        **_latest_error(rows, name),
    }
    if judged is None:
        return row
    level, u = judged.level
    return row | {
        "error_deg": level,
        "error_u_deg": u,
        "trend_deg_per_month": judged.course.slope,
        "trend_u_deg_per_month": judged.course.slope_uncertainty,
        "worse": judged.worse,
        "odd_sessions": int(judged.course.odd.sum()),
        "excess": judged.course.series.excess,
    }


def _latest_error(rows: pd.DataFrame, name: str) -> dict[str, Any]:
    """A joint's mean error in the last session that has a figure; undated ones come first."""
    own = rows[rows[f"{name}_mean_error_deg"].notna()]
    if not len(own):
        return {"latest_session": None}
    last = own.sort_values("started", kind="stable", na_position="first").iloc[-1]
    return {
        "latest_session": last["session"],
        "latest_started": _day(last["started"]),
        "latest_error_deg": last[f"{name}_mean_error_deg"],
        "latest_error_u_deg": last[f"{name}_standard_uncertainty_deg"],
        "latest_coverage_factor": last[f"{name}_coverage_factor"],
        "latest_tolerance_deg": last.get(f"{name}_tolerance_deg"),
        "latest_verdict": last[f"{name}_verdict"],
    }


_RECENT_COLUMNS = ["arm", "joint", "session", "order", "error_deg", "u_deg", "coverage_factor"]


def _recent_rows(sessions: pd.DataFrame) -> list[tuple[Any, ...]]:
    """Mean errors in the last sessions of each arm, `order` 0 the latest: fewer than a trend has.

    Undated sessions come before all others.
    """
    ordered = sessions.sort_values("started", kind="stable", na_position="first")
    return [
        (arm, joint, one["session"], order, one[f"q{joint}_mean_error_deg"],
         one[f"q{joint}_standard_uncertainty_deg"], one[f"q{joint}_coverage_factor"])
        for arm, rows in ordered.groupby("arm", sort=True)
        for order, (_, one) in enumerate(rows.iloc[: -MIN_SESSIONS_TO_ASSESS : -1].iterrows())
        for joint in range(1, int(one["joints"]) + 1)
        if pd.notna(one[f"q{joint}_mean_error_deg"])
    ]  # fmt: skip


Side = tuple[tuple[str, str, str], JointSeries, Flags]  # question, first, second; who is second


def _contrasts(
    sessions: pd.DataFrame, every: list[JointSeries], request: TrendRequest
) -> list[tuple[Any, ...]]:
    rows = _contrast_rows(_alternating_sides(every)) if request.by == "robot" else []
    if request.since is not None:
        day = pd.Timestamp(request.since, tz="UTC").value / DAY_NS
        names = "since", f"before {request.since}", f"since {request.since}"
        rows += _contrast_rows([(names, one, one.t >= day) for one in every])
    if request.compare is not None:
        first, second = (_sessions_below(sessions["session"], folder) for folder in request.compare)
        both = first | second
        some = [one.chosen(np.array([s in both for s in one.session], bool)) for one in every]
        chosen = [(one, np.array([s in second for s in one.session], bool)) for one in some]
        rows += _contrast_rows([(("compare", *request.compare), *pair) for pair in chosen])
    return rows


def _alternating_sides(every: list[JointSeries]) -> list[Side]:
    """Hold the sessions of a folder, or calibration, against others where their dates alternate.

    No change over time makes them differ: several arms may be taken as one.
    """
    folders = [np.array([str(PurePosixPath(s).parent) for s in one.session]) for one in every]
    return [
        ((question, "the others", str(name)), one, labels == name)
        for one, folder in zip(every, folders, strict=True)
        for question, labels in (("folder", folder), ("calibration", one.group))
        for name in np.unique(labels)
        if _alternates(labels == name)
    ]


def _alternates(second: Flags) -> bool:
    """Tell whether two sets of sessions, in order of time, mix as often as chance mixes them."""
    n, inside = len(second), int(second.sum())
    turns = int(np.count_nonzero(second[1:] != second[:-1]))
    return MIN_SESSIONS <= inside <= n - MIN_SESSIONS and turns >= 2 * inside * (n - inside) / n


def _contrast_rows(sides: list[Side]) -> list[tuple[Any, ...]]:
    possible = [side for side in sides if side[2].any() and not side[2].all()]
    rows = []
    for (question, *names), one, second in possible:
        difference = contrast(one, second, P_FALSE_ALARM / len(possible))
        size = abs(difference.difference)
        shown = size > difference.limit
        rows.append((question, one.arm, one.joint, *names, *difference.sessions,
                     *difference.level, difference.difference, difference.standard_uncertainty,
                     shown, size > difference.expected and not shown))  # fmt: skip
    return rows


def require_folders(names: Sequence[str], request: TrendRequest) -> None:
    """Raise InputError where a comparison has no session on a side, or one on both."""
    folders = request.compare or ()
    for folder in folders:
        if not _sessions_below(names, folder):
            raise InputError(
                f"--compare {folder}",
                "holds none of the sessions",
                "a folder with sessions of this batch is expected, written as in the command",
                "Name two of the batch's folders.",
            )
    shared = set.intersection(*(_sessions_below(names, folder) for folder in folders), set(names))
    if folders and shared:
        found = f"both hold the session {min(shared)}"
        expected = "two folders are expected, neither inside the other"
        raise InputError(f"--compare {' '.join(folders)}", found, expected)


def _sessions_below(names: Iterable[str], folder: str) -> set[str]:
    """Name the sessions below a folder."""
    start = folder.rstrip("/")
    return {name for name in names if name == start or name.startswith(f"{start}/")}


_WORST_COLUMNS = [
    "session", "arm", "started", "joint", "mean_error_deg", "mean_error_u_deg", "worst_error_deg",
    "worst_error_u_deg", "coverage_factor", "tolerance_deg", "joint_verdict", "pose",
    "verdict", "kept_in", "reported",
]  # fmt: skip


def _worst_sessions(sessions: pd.DataFrame, reported: set[str]) -> pd.DataFrame:
    """List the sessions with the largest resolved errors, those that do not conform first."""
    rows = [row for _, one in sessions.iterrows() if (row := _worst_row(one, reported))]
    severity = {"nonconform": 0, "undecided": 1}
    rows.sort(
        key=lambda r: (severity.get(r["verdict"], 2), -abs(r["worst_error_deg"]), r["session"])
    )
    return pd.DataFrame(rows[:MAX_WORST_SESSIONS], columns=_WORST_COLUMNS)


def _worst_row(session: pd.Series, reported: set[str]) -> dict[str, Any] | None:
    """Give a session's joint that is off most, of those with the session's verdict if any have."""
    joints = range(1, int(session["joints"]) + 1)
    errors = [
        (session[f"q{j}_verdict"] == session["verdict"], abs(session[f"q{j}_worst_error_deg"]), j)
        for j in joints
        if pd.notna(session[f"q{j}_worst_error_deg"])
    ]
    if not errors:
        return None
    joint = max(errors)[2]
    name = f"q{joint}"
    beyond = [part for part in ("position", "orientation")
              if session.get(f"{part}_verdict") == session["verdict"] != "conform"]  # fmt: skip
    return {
        "session": session["session"],
        "arm": session["arm"],
        "started": _day(session["started"]),
        "joint": joint,
        "mean_error_deg": session[f"{name}_mean_error_deg"],
        "mean_error_u_deg": session[f"{name}_standard_uncertainty_deg"],
        "worst_error_deg": session[f"{name}_worst_error_deg"],
        "worst_error_u_deg": session[f"{name}_worst_error_standard_uncertainty_deg"],
        "coverage_factor": session[f"{name}_coverage_factor"],
        "tolerance_deg": session.get(f"{name}_tolerance_deg"),
        "joint_verdict": session[f"{name}_verdict"],
        "pose": " and ".join(beyond),  # with the session's verdict
        "verdict": session["verdict"],
        "kept_in": session["kept_in"],
        "reported": session["session"] in reported,
    }


def _day(moment: Any) -> str | None:
    return None if pd.isna(moment) else moment.strftime("%Y-%m-%d")


def _summary(
    sessions: pd.DataFrame, failures: pd.DataFrame, request: TrendRequest, every: list[JointSeries]
) -> dict[str, Any]:
    started, verdicts = sessions["started"], sessions["verdict"].value_counts()
    return {
        "kind": "fleet",
        "format": 1,
        "tool": {"name": "verify", "version": __version__},
        "sessions": {
            "measured": len(sessions),
            "failed": int((failures["kind"] != COPY).sum()),
            "copies": int((failures["kind"] == COPY).sum()),
            "undated": int(started.isna().sum()),
            "first": _day(started.min()),
            "last": _day(started.max()),
            "pairs_recorded": int(sessions["pairs_recorded"].sum()),
            "pairs_measured": int(sessions["pairs_measured"].sum()),
        },
        "verdicts": {str(word): int(count) for word, count in sorted(verdicts.items())},
        "uncounted": sorted(
            {str(source) for own in sessions.get("uncounted", ()) for source in own}
        ),
        "arms": sorted({one.arm for one in every}),
        "false_alarm": P_FALSE_ALARM,
        "fewest_sessions": MIN_SESSIONS_TO_ASSESS,
        "by": request.by,
        "since": None if request.since is None else request.since.isoformat(),
        "compare": None if request.compare is None else list(request.compare),
    }
