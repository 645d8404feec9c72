"""Repeated poses and paths at the door: summary.json's entry and the tables, in mm and degrees."""

from typing import Any

import numpy as np
import pandas as pd

from verify.analysis.performance import indices, poses
from verify.analysis.performance.indices import Interval
from verify.analysis.performance.paths import PathIndices
from verify.analysis.performance.session import Performance

MM, DEG = 1e3, 180 / np.pi
AXES = ("rx", "ry", "rz")


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
        "outlying_visits": [
            {
                "pose": o.name,
                "visits": (o.visits + 1).tolist(),
                "pairs": o.pairs.tolist(),
                "off_mm": _rounded_or_none(o.apart[0], MM),
                "off_deg": _rounded_or_none(o.apart[1], DEG),
                "rp_without_mm": _rounded_or_none(o.repeatability, MM),
            }
            for o in found.outlying
        ],
        "deviations": deviations,
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
    return {"performance_poses": _visits(found), "performance_paths": _stations(found)}


def _visits(found: Performance | None) -> pd.DataFrame:
    names = ["pose", "visit", "t_s", "pairs", "came_from"]
    names += ["dx_mm", "dy_mm", "dz_mm", "drx_deg", "dry_deg", "drz_deg"]
    parts = []
    for p in found.poses if found else ():
        n = len(p.visits.t)
        turns = np.full((n, 3), np.nan) if p.angles is None else p.angles * DEG
        columns: list[Any] = [[p.visits.name] * n, np.arange(1, n + 1), p.visits.t]
        columns += [p.visits.counts.astype(np.int64), np.array(p.visits.came_from) + 1]
        columns += [*(p.deviations * MM).T, *turns.T]
        parts.append(pd.DataFrame(dict(zip(names, columns, strict=True))))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=names)


def _stations(found: Performance | None) -> pd.DataFrame:
    names = ["path", "station", "along_mm", "x_mm", "y_mm", "z_mm"]
    names += ["off_mm", "rt_mm", "largest_off_mm"]
    parts = []
    for p in found.paths if found else ():
        places = p.crossings
        off = places.attained - places.commanded[:, None]
        m = len(places.along)
        columns: list[Any] = [[p.name] * m, np.arange(1, m + 1), places.along * MM]
        barycentre = np.linalg.norm(off.mean(axis=1), axis=1)
        furthest = np.linalg.norm(off, axis=2).max(axis=1)
        columns += [*(places.commanded * MM).T, barycentre * MM]
        columns += [indices.repeatability(off) * MM, furthest * MM]
        parts.append(pd.DataFrame(dict(zip(names, columns, strict=True))))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=names)
