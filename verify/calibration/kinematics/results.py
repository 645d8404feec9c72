"""An identification as results, with the keys that `reports.identification.document` documents."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import robots
from reports import Results
from verify.calibration.kinematics.chain import Parameter
from verify.calibration.kinematics.identify import IdentificationResult, LevelResult
from verify.calibration.kinematics.placements import placement_entries
from verify.calibration.kinematics.poses import IdentificationPoses
from verify.calibration.kinematics.validation import statistics
from verify.calibration.origin import DEG, MM, ResultsOrigin
from verify.core.records import Array, Index
from verify.core.statistics import correlation


@dataclass(frozen=True, slots=True)
class ValidationSessions:
    """Sessions that the arm was not identified from, registered anew with either arm."""

    names: Sequence[str]
    before: Array  # (m, 6), m and rad: left by the arm as its file has it
    after: Array  # (m, 6), by the identified one


@dataclass(frozen=True, slots=True)
class IdentificationProvenance:
    """What an identification was made from."""

    origin: ResultsOrigin
    arm: robots.Arm
    names: Sequence[str]  # of the sources
    source: Index  # (n,), which of them each row is from
    frame: Index  # (n,), its number there
    free_base: bool
    free_tool: bool


def identification_results(
    found: IdentificationResult,
    poses: IdentificationPoses,
    made_from: IdentificationProvenance,
    robot_file: str,
    judged: ValidationSessions | None = None,
) -> Results:
    """Lay an identification out for the report; `judged` are other sessions that judge the arm."""
    chosen = found.chosen
    fitted = chosen.fit
    columns = made_from.source, made_from.frame, fitted.distance
    outlying = [column[~fitted.used].tolist() for column in columns]
    parameters = _parameters(chosen, found)
    summary = {
        **made_from.origin.summary("identification"),
        "robot": made_from.arm.name,
        "robot_fingerprint": f"sha256:{made_from.arm.fingerprint}",
        "robot_file": robot_file,
        "poses": {
            "used": int(fitted.used.sum()),
            "outlying": [
                {"source": made_from.names[i], "frame": frame, "squared_distance": distance}
                for i, frame, distance in zip(*outlying, strict=True)
            ],
            "position_only": poses.position_only,
        },
        "base_free": made_from.free_base,
        "tool_free": made_from.free_tool,
        "level": chosen.name,
        "levels": [_level(level) for level in found.levels],
        "identified": len(chosen.support.supported) - len(chosen.weak),
        "coverage_factor": fitted.coverage_factor,
        "recordings": {"count": len(np.unique(poses.recording)), "scatter": fitted.scatter},
        "rank": found.level("geometry").support.rank,
        "candidates": found.level("geometry").support.candidates,
        "parameters": parameters,
        "placements": placement_entries(fitted),
        "offsets": _offsets(found, made_from.arm.dof),
        "judged": None if judged is None else _judged_entries(judged, poses.position_only),
        "held": _held(found),
        "observability": found.observability,
        "parameter_correlation": {
            "parameters": [parameter.name for parameter in fitted.parameters],
            "correlation": correlation(fitted.covariance).tolist(),
        },
    }
    tables = {
        "residuals": _residuals(found, poses, made_from),
        "parameters": pd.DataFrame(parameters),
    }
    return Results(summary=summary, setup={}, tables=tables)


def _unit(parameter: Parameter) -> tuple[float, str]:
    return (DEG, "deg") if parameter.angular else (MM, "mm")


def _parameters(level: LevelResult, found: IdentificationResult) -> list[dict[str, Any]]:
    """Every identified number: as the arm's file has it, corrected, and how sure."""
    rows = []
    fit, chain = level.fit, found.chain
    for parameter, change, u in zip(
        fit.parameters, fit.change, fit.standard_uncertainty, strict=True
    ):
        scale, unit = _unit(parameter)
        now = None if parameter.axis else float(getattr(chain, parameter.kind)[parameter.place])
        rows.append(
            {
                "name": parameter.name,
                "kind": "offset" if parameter.kind == "correction" else parameter.kind,
                "joint": None if parameter.axis else parameter.place + 1,
                "unit": unit,
                "nominal": None if now is None else (now - change) * scale,
                "identified": None if now is None else now * scale,
                # a base or tool starts where a closed form put it: its change says nothing
                "change": None if now is None else change * scale,
                "standard_uncertainty": u * scale,
                "expanded_uncertainty": fit.coverage_factor * u * scale,
                "prior": None if parameter.axis else parameter.prior * scale,
            }
        )
    return rows


def _offsets(found: IdentificationResult, joints: int) -> list[dict[str, Any]]:
    """Each joint's constant error, encoder less measured, by the chosen model and by offsets."""
    rows = []
    for j in range(joints):
        row: dict[str, Any] = {"joint": j + 1}
        for head, level in (("", found.chosen), ("alone_", found.level("offsets"))):
            fit, wanted, value, u = level.fit, Parameter("correction", j), None, None
            if wanted in fit.parameters:
                k = fit.parameters.index(wanted)
                value, u = float(fit.change[k]) * DEG, float(fit.standard_uncertainty[k]) * DEG
            row[f"{head}error_deg"] = None if value is None else -value
            row[f"{head}add_to_reading_deg"] = value
            row[f"{head}standard_uncertainty_deg"] = u
            row[f"{head}expanded_uncertainty_deg"] = None if u is None else fit.coverage_factor * u
        rows.append(row)
    return rows


def _held(found: IdentificationResult) -> list[dict[str, Any]]:
    """List the parameters that the chosen model leaves as they were, and why."""
    largest, chosen = found.level("geometry"), found.chosen.fit.parameters
    held = [
        (one.parameter, "gauge" if one.redundant else "prior", one.uncertainty_if_free,
         one.confounded_with)
        for one in (*largest.support.held, *found.chosen.weak)
    ]  # fmt: skip
    sigma = zip(largest.fit.parameters, largest.fit.standard_uncertainty.tolist(), strict=True)
    held += [(p, "not_called_for", u, ()) for p, u in sigma if p not in chosen]
    return [
        {
            "name": parameter.name,
            "unit": _unit(parameter)[1],
            "reason": reason,
            "confounded_with": [{"name": p.name, "share": share} for p, share in confounded],
            # infinite of a gauge
            "standard_uncertainty_if_free": u * _unit(parameter)[0] if np.isfinite(u) else None,
        }
        for parameter, reason, u, confounded in held
    ]


def _level(level: LevelResult) -> dict[str, Any]:
    found = level.held_out
    return {
        "name": level.name,
        "identified": len(level.support.supported) - len(level.weak),
        "rank": level.support.rank,
        "candidates": level.support.candidates,
        "criterion": None if found is None else float(np.nanmean(found.chi2)),
        "noise_position": level.fit.scale.position,
        "noise_orientation": level.fit.scale.orientation,
        "outlying": int((~level.fit.used).sum()),
        "held_out": None
        if found is None
        else {
            "splits": found.splits,
            "rows": found.rows,
            **_lengths(found.position, found.orientation),
        },
    }


def _judged_entries(judged: ValidationSessions, position_only: bool) -> dict[str, Any]:
    row: dict[str, Any] = {"path": ", ".join(judged.names), "poses": len(judged.after)}
    for name, left in (("before", judged.before), ("after", judged.after)):
        turns = np.full(3, np.nan) if position_only else statistics(left[:, 3:])
        row[name] = _lengths(statistics(left[:, :3]), turns)
    return row


def _lengths(position: Array, orientation: Array) -> dict[str, float]:
    """Mean, rms and greatest length, (3,) m and (3,) rad, under the names of tables."""
    values = (*(position * MM).tolist(), *(orientation * DEG).tolist())
    names = [f"{name}_{unit}" for unit in ("mm", "deg") for name in ("mean", "rms", "max")]
    return dict(zip(names, values, strict=True))


def _residuals(
    found: IdentificationResult, poses: IdentificationPoses, made_from: IdentificationProvenance
) -> pd.DataFrame:
    table = {
        "source": [made_from.names[i] for i in made_from.source.tolist()],
        "frame": made_from.frame,
        "used": found.chosen.fit.used,
        "before_mm": np.linalg.norm(found.before[:, :3], axis=1) * MM,
        "after_mm": np.linalg.norm(found.after[:, :3], axis=1) * MM,
    }
    if not poses.position_only:
        table["before_deg"] = np.linalg.norm(found.before[:, 3:], axis=1) * DEG
        table["after_deg"] = np.linalg.norm(found.after[:, 3:], axis=1) * DEG
    return pd.DataFrame(table)
