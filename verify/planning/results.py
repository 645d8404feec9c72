"""A plan as results that `reports` words and keeps."""

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from reports import Results
from verify import __version__
from verify.planning import tables
from verify.planning.plan import Plan, Prediction
from verify.planning.prediction import Geometry
from verify.planning.timing import PERIOD, Timed
from verify.planning.wishes import Bench, Conditions, Wish
from verify.records import Array, Measurement

DEG, MM = float(np.deg2rad(1.0)), 1e-3


@dataclass(frozen=True, slots=True)
class Origin:
    """What a plan was made for."""

    bench: Bench
    wish: Wish
    conditions: Conditions
    inputs: dict[str, str]  # "sha256:…" by name
    warnings: tuple[str, ...]


def results(made: Plan, origin: Origin) -> Results:
    """Turn a plan into results.

    Args:
        made: the plan.
        origin: what it was made for.

    Returns:
        Summary as listed at the head of reports/plan.py; tables trajectory, poses, pairs, spots,
        arm, cameras, shown, sources.
    """
    predicted, timed = made.prediction, made.timed
    seen = predicted.foreseen
    summary: dict[str, Any] = {
        "format": 1,
        "kind": "plan",
        "tool": {"name": "verify", "version": __version__},
        "robot": origin.bench.arm.name,
        "robot_fingerprint": f"sha256:{origin.bench.arm.fingerprint}",
        "observe": list(origin.wish.observe),
        "motion": _motion(timed, origin),
        "pairs": _pairs(seen.measurements),
        "candidates": {"tried": made.known.tried, "excluded": made.known.excluded},
        "conditions": _conditions(origin.conditions),
        "image_size": list(origin.bench.rig.image_size),
        "joints": _joints(predicted, timed),
        "joint_error_correlation": _correlation(predicted.judged.means.covariance),
        "clock": _clock(predicted),
        "geometry": None if predicted.geometry is None else _geometry(predicted.geometry),
        "through_encoders": seen.model.through_encoders,
        "uncounted": list(seen.systematics.uncounted),
        "inputs": dict(sorted(origin.inputs.items())),
        "warnings": list(origin.warnings),
    }
    kept = {
        "trajectory": tables.trajectory(timed),
        "poses": tables.poses(timed),
        "pairs": tables.pairs(predicted),
        "spots": tables.spots(seen.measurements, origin.bench),
        "arm": tables.arm(timed, origin.bench),
        "cameras": tables.cameras(origin.bench),
        "shown": tables.shown(predicted),
        "sources": tables.sources_table(predicted),
    }
    return Results(summary=summary, setup={}, tables=kept)


def _motion(timed: Timed, origin: Origin) -> dict[str, Any]:
    visited = [stop.pose for stop in timed.stops if stop.pose is not None]
    return {
        "duration_s": timed.duration,
        "poses": len(set(visited)),
        "visits": len(visited),
        "hold_s": origin.wish.hold,
        "there_and_back": origin.wish.there_and_back,
        "view_angle_deg": float(np.rad2deg(origin.wish.view_angle)),
        "floor_mm": origin.wish.floor * 1e3,
        "seed": origin.wish.seed,
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


def _conditions(conditions: Conditions) -> dict[str, Any]:
    u = conditions.clock_uncertainty
    return {
        "rate_hz": conditions.rate,
        "skew_ms": conditions.skew * 1e3,
        "spot_noise_px": conditions.spot_noise,
        "reading_rate_hz": conditions.reading_rate,
        "reading_noise_deg": float(np.rad2deg(conditions.reading_noise)),
        "clock_standard_uncertainty_ms": None if u is None else u * 1e3,
    }


def _joints(predicted: Prediction, timed: Timed) -> list[dict[str, Any]]:
    means, seen = predicted.judged.means, predicted.foreseen
    visible = predicted.judged.visibility
    spread = np.sqrt(np.diag(means.covariance))
    t = np.append(np.arange(0.0, timed.duration, PERIOD), timed.duration)
    q, comparison = timed.q(t), seen.comparison
    speed = np.abs(np.gradient(q, t, axis=0)).max(axis=0)
    upward = np.mean(comparison.direction > 0, axis=0)
    return [
        {
            "joint": j + 1,
            "standard_uncertainty_deg": _deg(spread[j]),
            "expanded_uncertainty_deg": _deg(means.coverage_factor[j] * spread[j]),
            "coverage_factor": _number(means.coverage_factor[j]),
            "visible_fraction": _number(visible.fraction[j]),
            "visible_fraction_since_registration": _number(visible.fraction_since[j]),
            "minimum_detectable_error_deg": _deg(visible.detectable[j]),
            "minimum_separable_error_deg": _deg(visible.separable[j]),
            "lowest_deg": _deg(q[:, j].min()),
            "highest_deg": _deg(q[:, j].max()),
            "greatest_speed_deg_s": _deg(speed[j]),
            "upward_share": _number(upward[j]),
            "kinds": [
                {
                    "kind": one.name,
                    "unit": one.unit,
                    "standard_uncertainty": _number(one.standard_uncertainty[j] / one.scale),
                    "minimum_detectable": _number(one.detectable[j] / one.scale),
                }
                for one in predicted.shown
            ],
        }
        for j in range(len(spread))
    ]


def _clock(predicted: Prediction) -> dict[str, Any]:
    clock = predicted.clock
    return {
        "source": clock.source,
        "standard_uncertainty_s": clock.standard_uncertainty,
        "minimum_detectable_error_s": clock.detectable,
    }


def _geometry(found: Geometry) -> dict[str, Any]:
    return {
        "supported": len(found.parameters),
        "candidates": found.support.candidates,
        "rank": found.support.rank,
        "parameters": [
            {
                "name": parameter.name,
                "unit": "deg" if parameter.angular else "mm",
                "standard_uncertainty": float(u / (DEG if parameter.angular else MM)),
            }
            for parameter, u in zip(found.parameters, found.standard_uncertainty, strict=True)
        ],
        "held": [
            {
                "name": held.parameter.name,
                "reason": "gauge" if held.redundant else "not_supported",
            }
            for held in found.support.held
        ],
        "observability": found.indexes,
    }


def _correlation(covariance: Array) -> list[list[float | None]]:
    sigma = np.sqrt(np.diag(covariance))
    rows = covariance / np.outer(sigma, sigma)
    return [[_number(value) for value in row] for row in rows]


def _deg(value: float) -> float | None:
    return _number(np.rad2deg(value))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
