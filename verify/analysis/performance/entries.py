"""Repeated poses and paths at the door, in mm and degrees: summary.json's entry, and the tables.

The entry lists in what the session differs from ISO 9283's conditions.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import pandas as pd

from verify.analysis.performance import indices, poses
from verify.analysis.performance.holds import far_off
from verify.analysis.performance.indices import Interval
from verify.analysis.performance.paths import PathIndices
from verify.analysis.performance.session import Performance, performance
from verify.analysis.results.summary import SessionAnalysis
from verify.core.readings import Readings
from verify.io.session.keys import RunTable
from verify.io.toml import decode

MM, DEG = 1e3, 180 / np.pi
AXES = ("rx", "ry", "rz")
VISIT_COLUMNS = ("pose", "visit", "t_s", "pairs", "came_from", "dx_mm", "dy_mm", "dz_mm",
                 "drx_deg", "dry_deg", "drz_deg")  # fmt: skip
STATION_COLUMNS = ("path", "station", "along_mm", "x_mm", "y_mm", "z_mm", "off_mm", "rt_mm",
                   "largest_off_mm")  # fmt: skip
CYCLES, PASSAGES, POSES = 30, 10, 5
MAX_UNCERTAINTY_SHARE = 0.25  # of a characteristic, that the uncertainty of measurement may reach
TEMPERATURE_C = (18.0, 22.0)
MIN_DRIFT_S = 8 * 3600.0
MAX_OFF_PLANE = 0.02  # of the poses' extent: off one plane by less is in it


def performance_summary(found: Performance, deviations: list[dict[str, Any]]) -> dict[str, Any]:
    """Word the indices as `performance` of summary.json (docs/performance.md)."""
    noise = found.noise
    return {
        "style": "ISO 9283-style",
        "recognised": "named" if found.named else "motion",
        "coverage": 0.95,
        "point_mm": [_rounded_or_none(v, MM) for v in found.point],
        "noise_floor": {
            "source": noise.source,
            "degrees_of_freedom": noise.freedom,
            "position_mm": [_rounded_or_none(v, MM) for v in np.sqrt(np.diag(noise.position))],
            "rotation_deg": [_rounded_or_none(v, DEG) for v in np.sqrt(np.diag(noise.turn))]
            if found.oriented
            else None,
            "correlation_factor": _rounded_or_none(noise.together),
        },
        "poses": [_pose(p, timed=np.isfinite(found.duration)) for p in found.poses],
        "distances": [_distance(d) for d in found.distances],
        "paths": [_path(p) for p in found.paths],
        "poses_seldom_visited": found.seldom,
        "named_but_not_seen": [
            {"name": n.name, "t_start_s": n.start, "t_end_s": n.end} for n in found.empty
        ],
        "pairs_left_out": found.left_out.tolist(),
        "outlying_visits": list(_outlying(found)),
        "deviations": deviations,
    }


def _outlying(found: Performance) -> Iterator[dict[str, Any]]:
    """Visits far off the others of their pose; they count, as nothing shows whose mistake it is."""
    far = far_off([p.visits.own for p in found.poses], oriented=found.oriented)
    for p, away in zip(found.poses, far, strict=True):
        if away.any():
            apart = (p.visits.own - np.median(p.visits.own, axis=0))[away].reshape(-1, 2, 3)
            size = np.linalg.norm(apart, axis=2).max(axis=0)
            visits = np.flatnonzero(away)
            others = float(indices.repeatability(p.deviations[~away]))
            yield {
                "pose": p.visits.name,
                "visits": (visits + 1).tolist(),
                "pairs": [int(frame) for i in visits for frame in p.visits.pairs[i]],
                "off_mm": _rounded_or_none(size[0], MM),
                "off_deg": _rounded_or_none(size[1], DEG) if found.oriented else None,
                "rp_without_mm": _rounded_or_none(others, MM),
            }


def _rounded_or_none(value: float, scale: float = 1.0) -> float | None:
    """Null where it is not known, never NaN; a picometre is no figure."""
    return round(float(value) * scale, 9) if np.isfinite(value) else None


def _interval(found: Interval, name: str, unit: str, scale: float) -> dict[str, float | None]:
    return {
        f"{name}_{unit}": _rounded_or_none(found.value, scale),
        f"{name}_low_{unit}": _rounded_or_none(found.low, scale),
        f"{name}_high_{unit}": _rounded_or_none(found.high, scale),
    }


def _accuracy(found: poses.PoseAccuracy, name: str) -> dict[str, Any]:
    return {
        **_interval(found.found, name, "mm", MM),
        f"{name}_components_mm": [_rounded_or_none(v, MM) for v in found.mean],
        f"{name}_of_noise_mm": _rounded_or_none(found.noise, MM),
        f"{name}_less_bias_mm": _rounded_or_none(found.unbiased, MM),
        f"{name}_expanded_uncertainty_mm": _rounded_or_none(found.expanded_uncertainty, MM),
    }


def _repeatability(
    found: poses.Repeatability, name: str, unit: str, scale: float
) -> dict[str, float | None]:
    return {
        **_interval(found.found, name, unit, scale),
        f"{name}_floor_{unit}": _rounded_or_none(found.floor, scale),
        f"{name}_robot_{unit}": _rounded_or_none(found.robot, scale),
        f"{name}_robot_at_most_{unit}": _rounded_or_none(found.robot_at_most, scale),
    }


def _pose(p: poses.PoseIndices, *, timed: bool) -> dict[str, Any]:
    worded: dict[str, Any] = {
        "pose": p.visits.name,
        "visits": len(p.visits.t),
        "pairs": int(p.visits.counts.sum()),
        "commanded_mm": [_rounded_or_none(v, MM) for v in p.commanded[:3, 3]],
        **_accuracy(p.accuracy, "ap"),
        **_repeatability(p.repeatability, "rp", "mm", MM),
    }
    for i, axis in enumerate(AXES if p.angles is not None else ()):
        worded |= _interval(p.angle_accuracy[i], f"ap_{axis}", "deg", DEG)
        worded |= _repeatability(p.angle_repeatability[i], f"rp_{axis}", "deg", DEG)
    if p.variation is not None:
        worded["variation"] = {
            "ways": p.variation.ways,
            **_interval(p.variation.position, "vap", "mm", MM),
            "vap_of_noise_mm": _rounded_or_none(p.variation.noise, MM),
            "vap_deg": _rounded_or_none(p.variation.turn, DEG),
        }
    if p.drift is not None:
        worded["drift"] = {
            "blocks": p.drift.blocks,
            "duration_s": _rounded_or_none(np.ptp(p.visits.t) if timed else np.nan),
            "dap_mm": _rounded_or_none(p.drift.accuracy, MM),
            "dap_of_noise_mm": _rounded_or_none(p.drift.noise[0], MM),
            "drp_mm": _rounded_or_none(p.drift.repeatability, MM),
            "drp_of_noise_mm": _rounded_or_none(p.drift.noise[1], MM),
        }
    return worded


def _distance(d: poses.DistanceIndices) -> dict[str, Any]:
    return {
        "poses": list(d.names),
        "commanded_mm": _rounded_or_none(d.commanded, MM),
        "visits": d.visits,
        **_interval(d.accuracy, "ad", "mm", MM),
        **_interval(d.repeatability, "rd", "mm", MM),
    }


def _path(p: PathIndices) -> dict[str, Any]:
    worded: dict[str, Any] = {
        "path": p.name,
        "passages": p.passages,
        "length_mm": _rounded_or_none(p.length, MM),
        "speed_mm_s": _rounded_or_none(p.speed, MM),
        **_accuracy(p.accuracy, "at"),
        "at_place_mm": _rounded_or_none(p.accuracy_at, MM),
        "at_largest_of_noise_mm": _rounded_or_none(p.accuracy_noise, MM),
        **_repeatability(p.repeatability, "rt", "mm", MM),
        "rt_place_mm": _rounded_or_none(p.repeatability_at, MM),
    }
    if p.turn_accuracy is not None and p.turn_repeatability is not None:
        for i, axis in enumerate(AXES):
            worded[f"at_{axis}_deg"] = _rounded_or_none(p.turn_accuracy[i], DEG)
            worded[f"rt_{axis}_deg"] = _rounded_or_none(p.turn_repeatability[i], DEG)
    return worded


def performance_tables(found: Performance | None) -> dict[str, pd.DataFrame]:
    """A row a visit of a pose, and a row a station of a path; none where there are none."""
    visits = map(_visits, found.poses if found else ())
    stations = map(_stations, found.paths if found else ())
    return {
        "performance_poses": _stacked(VISIT_COLUMNS, visits),
        "performance_paths": _stacked(STATION_COLUMNS, stations),
    }


def _stacked(names: tuple[str, ...], parts: Iterable[list[Any]]) -> pd.DataFrame:
    tables = [pd.DataFrame(dict(zip(names, columns, strict=True))) for columns in parts]
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(columns=names)


def _visits(p: poses.PoseIndices) -> list[Any]:
    n = len(p.visits.t)
    turns = np.full((n, 3), np.nan) if p.angles is None else p.angles * DEG
    columns: list[Any] = [[p.visits.name] * n, np.arange(1, n + 1), p.visits.t]
    columns += [p.visits.counts.astype(np.int64), np.array(p.visits.came_from) + 1]
    return [*columns, *(p.deviations * MM).T, *turns.T]


def _stations(p: PathIndices) -> list[Any]:
    places, m = p.crossings, len(p.crossings.along)
    off = places.attained - places.commanded[:, None]
    barycentre = np.linalg.norm(off.mean(axis=1), axis=1)
    furthest = np.linalg.norm(off, axis=2).max(axis=1)
    columns: list[Any] = [[p.name] * m, np.arange(1, m + 1), places.along * MM]
    columns += [*(places.commanded * MM).T, barycentre * MM]
    return [*columns, indices.repeatability(off) * MM, furthest * MM]


def condition_deviations(
    found: Performance, *, temperature_c: float | None, through_encoders: bool
) -> list[dict[str, Any]]:
    """List what is other than the standard's conditions, or not known.

    One entry a deviation: its `kind`, and figures that belong to it. `through_encoders`: base or
    LEDs were registered through the robot's own encoders.
    """
    listed: list[dict[str, Any]] = []
    if found.poses:
        fewest = min(len(p.visits.t) for p in found.poses)
        if fewest < CYCLES:
            listed.append({"kind": "cycles", "found": fewest, "standard": CYCLES})
        listed += _mean_positions(found.poses)
        mixed = [p.visits.name for p in found.poses if p.variation is not None]
        if mixed:
            listed.append({"kind": "approach", "poses": mixed})
        if any(p.drift for p in found.poses) and not found.duration >= MIN_DRIFT_S:
            seconds = round(found.duration, 3) if np.isfinite(found.duration) else None
            listed.append({"kind": "drift", "found_s": seconds})
        listed += _uncertain_poses(found.poses)
    if found.paths:
        fewest = min(p.passages for p in found.paths)
        if fewest < PASSAGES:
            listed.append({"kind": "passages", "found": fewest, "standard": PASSAGES})
    if through_encoders:
        listed.append({"kind": "registration"})
    listed.append({"kind": "commanded"})
    if temperature_c is None:
        listed.append({"kind": "temperature_unknown"})
    elif not TEMPERATURE_C[0] <= temperature_c <= TEMPERATURE_C[1]:
        listed.append({"kind": "temperature", "found_c": temperature_c})
    listed += [{"kind": kind} for kind in ("load", "speed", "warm_up", "settling", "cube")]
    listed.append({"kind": "point" if np.any(found.point) else "flange"})
    return listed


def _mean_positions(poses: tuple[poses.PoseIndices, ...]) -> list[dict[str, Any]]:
    if len(poses) != POSES:
        return [{"kind": "poses", "found": len(poses), "standard": POSES}]
    places = np.array([p.commanded[:3, 3] for p in poses])
    centred = places - places.mean(axis=0)
    _, size, axes = np.linalg.svd(centred)
    off = float(np.abs(centred @ axes[2]).max())  # m, from the best plane
    if off <= MAX_OFF_PLANE * size[0]:
        return []
    return [{"kind": "plane", "off_plane_mm": round(off * 1e3, 3)}]


def _uncertain_poses(poses: tuple[poses.PoseIndices, ...]) -> list[dict[str, Any]]:
    """Name poses whose accuracy is stated with more than a quarter of itself in doubt."""
    doubtful = [
        p.visits.name
        for p in poses
        if p.accuracy.expanded_uncertainty > MAX_UNCERTAINTY_SHARE * p.accuracy.found.value
    ]
    if not doubtful:
        return []
    smallest = max(p.accuracy.expanded_uncertainty for p in poses) / MAX_UNCERTAINTY_SHARE
    return [{"kind": "uncertainty", "poses": doubtful, "smallest_mm": round(smallest * 1e3, 6)}]


def session_performance(judged: SessionAnalysis) -> tuple[dict[str, Any], dict[str, pd.DataFrame]]:
    """Find and judge the poses and paths that a session names or, where it names none, repeats.

    Gives `performance` (null where nothing is repeated) and `performance_reason` (why, else null)
    of summary.json; and the tables.
    """
    session, model = judged.compared.session, judged.model
    file = session.folder / "session.toml"  # a simulated one has no folder
    table = decode(file, RunTable)[0] if file.exists() else None
    named, paths = ((), ()) if table is None else (table.pose, table.path)
    other = session.instrument
    found = performance(
        model,
        session.arm,
        Readings(session.encoders.t, session.encoders.q),
        judged.compared.clock.offset,
        named_poses=named,
        named_paths=paths,
        point=other.flange_T_body[:3, 3] if other and other.positions_alone else None,
        timed=session.frames.timed,
        frame=judged.frame.astype(np.int64),
    )
    if not isinstance(found, Performance):
        return {"performance": None, "performance_reason": found}, performance_tables(None)
    listed = condition_deviations(
        found, temperature_c=session.temperature_c, through_encoders=model.through_encoders
    )
    entry = performance_summary(found, listed)
    return {"performance": entry, "performance_reason": None}, performance_tables(found)
