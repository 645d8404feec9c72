"""How a session's conditions differ from those that ISO 9283 sets: a list, never silence."""

from typing import Any

import numpy as np

from verify.performance.assess import PoseIndices
from verify.performance.session import Performance
from verify.records import Array

CYCLES, PASSAGES, POSES = 30, 10, 5
SHARE = 0.25  # of a characteristic, that the uncertainty of measurement may reach
TEMPERATURE_C = (18.0, 22.0)
DRIFT_S = 8 * 3600.0
FLAT = 0.02  # of the poses' extent: off one plane by less is in it


def deviations(
    found: Performance, *, temperature_c: float | None, through_encoders: bool
) -> list[dict[str, Any]]:
    """List what is other than the standard's conditions, or not known.

    Args:
        found: the indices.
        temperature_c: of the session, where it is stated.
        through_encoders: base or LEDs were registered through the robot's own encoders.

    Returns:
        One entry a deviation: its `kind`, and figures that belong to it.
    """
    listed: list[dict[str, Any]] = []
    if found.poses:
        fewest = min(len(p.stands.t) for p in found.poses)
        if fewest < CYCLES:
            listed.append({"kind": "cycles", "found": fewest, "standard": CYCLES})
        listed += _places(found.poses)
        mixed = [p.stands.name for p in found.poses if p.variation is not None]
        if mixed:
            listed.append({"kind": "approach", "poses": mixed})
        if any(p.drift for p in found.poses) and found.duration < DRIFT_S:
            listed.append({"kind": "drift", "found_s": round(found.duration, 3)})
        listed += _capability(found.poses)
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


def _places(poses: tuple[PoseIndices, ...]) -> list[dict[str, Any]]:
    if len(poses) != POSES:
        return [{"kind": "poses", "found": len(poses), "standard": POSES}]
    places = np.array([p.commanded[:3, 3] for p in poses])
    off, extent = _flatness(places)
    if off <= FLAT * extent:
        return []
    return [{"kind": "plane", "off_plane_mm": round(off * 1e3, 3)}]


def _flatness(places: Array) -> tuple[float, float]:
    """Largest distance from the best plane, and the extent in it, m."""
    centred = places - places.mean(axis=0)
    _, size, axes = np.linalg.svd(centred)
    return float(np.abs(centred @ axes[2]).max()), float(size[0])


def _capability(poses: tuple[PoseIndices, ...]) -> list[dict[str, Any]]:
    """Name poses whose accuracy is stated with more than a quarter of itself in doubt."""
    doubtful = [
        p.stands.name
        for p in poses
        if p.accuracy.expanded_uncertainty > SHARE * p.accuracy.found.value
    ]
    if not doubtful:
        return []
    smallest = max(p.accuracy.expanded_uncertainty for p in poses) / SHARE
    return [{"kind": "uncertainty", "poses": doubtful, "smallest_mm": round(smallest * 1e3, 6)}]
