"""Write a plan as results for `reports`: summary, and tables for a controller and for figures."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

import robots
from reports import Results
from verify.analysis.results.entries import correlation_entry, finite_number
from verify.core.records import Array, Measurement
from verify.core.version import __version__
from verify.planning import prediction
from verify.planning.constraints import LinkChain
from verify.planning.foresight import PredictedSession
from verify.planning.plan import SessionPlan, SessionPrediction
from verify.planning.proposal import ProposedRig
from verify.planning.request import PlanningSetup, PlanRequest, SessionConditions
from verify.planning.selection import PERIOD, TimedMotion

MAX_DRAWN_ARMS = 6  # of the poses, in the picture of the path
FLANGE_STEP = 0.25  # s between the points of the flange's path


def trajectory_table(timed: TimedMotion) -> pd.DataFrame:
    """The motion in even steps: t_s, q1_deg…, and the pose at which the arm rests, from 1."""
    t = timed.times(PERIOD)
    rest = [None if k is None else k + 1 for k in timed.resting(t)]
    table = pd.DataFrame({"t_s": t, **_angles(timed.q(t))})
    table["pose"] = pd.array(rest, dtype="Int64")
    return table


def pose_table(timed: TimedMotion) -> pd.DataFrame:
    """The stops, for a controller that goes from pose to pose by itself."""
    number = [None if stop.pose is None else stop.pose + 1 for stop in timed.stops]
    return pd.DataFrame(
        {
            "stop": np.arange(1, len(timed.stops) + 1),
            "pose": pd.array(number, dtype="Int64"),
            "arrive_s": timed.arrive,
            "leave_s": timed.leave,
            "pace": np.concatenate([[np.nan], timed.pace]),
            **_angles(np.array([stop.q for stop in timed.stops])),
        }
    )


def pair_table(predicted: SessionPrediction) -> pd.DataFrame:
    """Status and joint angles of each pair."""
    session = predicted.session
    status = [m.status for m in session.measurements]
    columns = {"frame": np.arange(len(status)), "t_s": session.t, "status": status}
    return pd.DataFrame(columns | _angles(session.q))


def spot_table(measurements: list[Measurement], setup: PlanningSetup) -> pd.DataFrame:
    """Every LED image of every pair that was measured."""
    rows = [
        (m.frame, camera, setup.marker.names[led], x, y)
        for m in measurements
        for camera, sighting in (("left", m.left), ("right", m.right))
        if sighting is not None
        for led, (x, y) in zip(sighting.led.tolist(), sighting.centre.tolist(), strict=True)
    ]
    return pd.DataFrame(rows, columns=["frame", "camera", "led", "x_px", "y_px"])


def arm_table(timed: TimedMotion, setup: PlanningSetup) -> pd.DataFrame:
    """The flange's path, and the links at some of the poses; robot's base frame."""
    flange = robots.forward(setup.arm, timed.q(timed.times(FLANGE_STEP)))[:, :3, 3] * 1e3
    rows = [("flange", 0, *place) for place in flange.tolist()]
    stops = [stop.q for stop in timed.stops if stop.pose is not None]
    some = np.unique(np.linspace(0, len(stops) // 2, MAX_DRAWN_ARMS).astype(int))
    frames = robots.link_frames(setup.arm, np.array([stops[k] for k in some]))
    points = LinkChain(setup.arm).points(frames)
    for number, arm in enumerate(points * 1e3, start=1):
        rows += [("arm", number, *place) for place in arm.tolist()]
    return pd.DataFrame(rows, columns=["what", "number", "x_mm", "y_mm", "z_mm"])


def camera_table(setup: PlanningSetup) -> pd.DataFrame:
    """Positions and optical axes of the cameras; robot's base frame."""
    base_T_rig = np.linalg.inv(setup.rig.rig_T_base)
    rows = []
    for name, camera in (("left", setup.rig.left), ("right", setup.rig.right)):
        placed = base_T_rig @ camera.rig_T_camera(camera.pan)
        rows.append((name, *(placed[:3, 3] * 1e3).tolist(), *placed[:3, 2].tolist()))
    return pd.DataFrame(
        rows, columns=["camera", "x_mm", "y_mm", "z_mm", "axis_x", "axis_y", "axis_z"]
    )


def fault_table(predicted: SessionPrediction) -> pd.DataFrame:
    """Every kind of fault of every joint."""
    rows = [
        (j + 1, one.name, one.unit, one.standard_uncertainty[j], one.detectable[j])
        for one in predicted.faults
        for j in range(len(one.detectable))
    ]
    names = ["joint", "kind", "unit", "standard_uncertainty", "minimum_detectable"]
    return pd.DataFrame(rows, columns=names)


def source_table(sources: dict[str, Array]) -> pd.DataFrame:
    """Sources of each joint's uncertainty."""
    rows = [
        (j + 1, name, u)
        for name, share in sources.items()
        for j, u in enumerate(np.rad2deg(share).tolist())
    ]
    return pd.DataFrame(rows, columns=["joint", "source", "standard_uncertainty_deg"])


def _angles(q: Array) -> dict[str, Array]:
    return {f"q{j + 1}_deg": np.rad2deg(q[:, j]) for j in range(q.shape[1])}


@dataclass(frozen=True, slots=True)
class PlanProvenance:
    """Inputs of a plan."""

    setup: PlanningSetup
    request: PlanRequest
    conditions: SessionConditions
    inputs: dict[str, str]  # "sha256:…" by name
    warnings: tuple[str, ...]
    proposed: ProposedRig | None = None  # a rig that does not exist yet
    tolerance: Array | None = None  # (j,), rad


def plan_results(made: SessionPlan, origin: PlanProvenance) -> Results:
    """Turn a plan into summary and tables as docs/plan.md lists them."""
    predicted, timed = made.prediction, made.timed
    session = predicted.session
    sources = prediction.uncertainty_sources(predicted.analysis)
    summary: dict[str, Any] = {
        "format": 1,
        "kind": "plan",
        "tool": {"name": "verify", "version": __version__},
        "robot": origin.setup.arm.name,
        "robot_fingerprint": f"sha256:{origin.setup.arm.fingerprint}",
        "observe": list(origin.request.observe),
        "motion": _motion(timed, origin),
        "pairs": _pairs(session.measurements),
        "candidates": {"tried": made.roadmap.tried, "excluded": made.roadmap.excluded},
        "conditions": _conditions(origin.conditions),
        "image_size": list(origin.setup.rig.image_size),
        "rig": None if origin.proposed is None else rig_entry(origin.proposed),
        "flange": flange_entry(session),
        "joints": _joints(predicted, timed, sources, origin.tolerance),
        "joint_error_correlation": correlation_entry(predicted.analysis.resolved.mean_covariance),
        "clock": {
            "source": predicted.clock.source,
            "standard_uncertainty_s": predicted.clock.standard_uncertainty,
            "minimum_detectable_error_s": predicted.clock.detectable,
        },
        "geometry": None if predicted.geometry is None else _geometry(predicted.geometry),
        "through_encoders": session.model.through_encoders,
        "uncounted": list(session.systematics.uncounted),
        "inputs": dict(sorted(origin.inputs.items())),
        "warnings": list(origin.warnings),
    }
    kept = {
        "trajectory": trajectory_table(timed),
        "poses": pose_table(timed),
        "pairs": pair_table(predicted),
        "spots": spot_table(session.measurements, origin.setup),
        "arm": arm_table(timed, origin.setup),
        "cameras": camera_table(origin.setup),
        "shown": fault_table(predicted),
        "sources": source_table(sources),
    }
    return Results(summary=summary, setup={}, tables=kept)


def rig_entry(proposed: ProposedRig) -> dict[str, Any]:
    """Describe a rig that does not exist yet, with the standard uncertainties taken as typical."""
    return {
        "image_size": list(proposed.image_size),
        "field_of_view_deg": float(np.rad2deg(proposed.field_of_view)),
        "focal_px": proposed.focal,
        "baseline_m": proposed.baseline,
        "distance_m": proposed.distance,
        "vergence_deg": float(np.rad2deg(proposed.vergence)),
        "leds": proposed.leds,
        "led_circle_mm": proposed.led_circle * 1e3,
        "standard_uncertainties": dict(proposed.uncertainties),
    }


def flange_entry(session: PredictedSession) -> dict[str, Any]:
    """Standard uncertainty of the flange as one pair measures it."""
    position, orientation = prediction.flange_uncertainty(session)
    return {
        "standard_uncertainty_mm": finite_number(position * 1e3),
        "standard_uncertainty_deg": _deg(orientation),
    }


def _motion(timed: TimedMotion, origin: PlanProvenance) -> dict[str, Any]:
    visited = [stop.pose for stop in timed.stops if stop.pose is not None]
    return {
        "duration_s": timed.duration,
        "poses": len(set(visited)),
        "visits": len(visited),
        "hold_s": origin.request.hold,
        "there_and_back": "backlash" in origin.request.observe,
        "view_angle_deg": float(np.rad2deg(origin.request.view_angle)),
        "floor_mm": origin.request.floor * 1e3,
        "seed": origin.request.seed,
    }


def _pairs(measurements: list[Measurement]) -> dict[str, Any]:
    counts = Counter(m.status for m in measurements)
    measured = counts.pop("measured", 0)
    return {
        "recorded": len(measurements),
        "measured": measured,
        "rejected": dict(counts),
        "measured_share": measured / len(measurements),
    }


def _conditions(conditions: SessionConditions) -> dict[str, Any]:
    u = conditions.clock_uncertainty
    return {
        "rate_hz": conditions.rate,
        "skew_ms": conditions.skew * 1e3,
        "spot_noise_px": conditions.spot_noise,
        "reading_rate_hz": conditions.reading_rate,
        "reading_noise_deg": float(np.rad2deg(conditions.reading_noise)),
        "clock_standard_uncertainty_ms": None if u is None else u * 1e3,
    }


def _joints(
    predicted: SessionPrediction,
    timed: TimedMotion,
    sources: dict[str, Array],
    tolerance: Array | None,
) -> list[dict[str, Any]]:
    """How well each joint will be known, how it moves, and what its mean's uncertainty is from."""
    analysis, session = predicted.analysis, predicted.session
    visible, factor = analysis.visibility, analysis.coverage_factor
    spread = np.sqrt(np.diag(analysis.resolved.mean_covariance))
    t = timed.times(PERIOD)
    q, comparison = timed.q(t), session.comparison
    speed = np.abs(np.gradient(q, t, axis=0)).max(axis=0)
    upward = np.mean(comparison.direction > 0, axis=0)
    levers, parts = prediction.joint_levers(session), prediction.group_sources(sources)
    largest = analysis.resolved.uncertainty.max(axis=0)
    limits = None if tolerance is None else prediction.conform_limits(analysis, tolerance)
    return [
        {
            "joint": j + 1,
            "standard_uncertainty_deg": _deg(spread[j]),
            "expanded_uncertainty_deg": _deg(factor[j] * spread[j]),
            "coverage_factor": finite_number(factor[j]),
            "visible_fraction": finite_number(visible.fraction[j]),
            "visible_fraction_since_registration": finite_number(visible.fraction_since[j]),
            "minimum_detectable_error_deg": _deg(visible.detectable[j]),
            "minimum_separable_error_deg": _deg(visible.separable[j]),
            "lowest_deg": _deg(q[:, j].min()),
            "highest_deg": _deg(q[:, j].max()),
            "greatest_speed_deg_s": _deg(speed[j]),
            "upward_share": finite_number(upward[j]),
            "kinds": [
                {
                    "kind": one.name,
                    "unit": one.unit,
                    "standard_uncertainty": finite_number(one.standard_uncertainty[j]),
                    "minimum_detectable": finite_number(one.detectable[j]),
                }
                for one in predicted.faults
            ],
            "lever_mm": finite_number(levers[j] * 1e3),
            "largest_standard_uncertainty_deg": _deg(largest[j]),
            "parts_deg": {name: _deg(u[j]) for name, u in parts.items()},
            "tolerance_deg": None if tolerance is None else _deg(tolerance[j]),
            "conform_limit_deg": None if limits is None else _deg(limits[j]),
        }
        for j in range(len(spread))
    ]


def _geometry(found: prediction.PredictedIdentifiability) -> dict[str, Any]:
    supported = found.support.supported
    return {
        "supported": len(supported),
        "candidates": found.support.candidates,
        "rank": found.support.rank,
        "parameters": [
            {
                "name": parameter.name,
                "unit": "deg" if parameter.angular else "mm",
                "standard_uncertainty": float(u / parameter.tolerance),
            }
            for parameter, u in zip(supported, found.standard_uncertainty, strict=True)
        ],
        "held": [
            {"name": held.parameter.name, "reason": "gauge" if held.redundant else "not_supported"}
            for held in found.support.held
        ],
        "observability": found.indexes,
    }


def _deg(value: float) -> float | None:
    return finite_number(np.rad2deg(value))
