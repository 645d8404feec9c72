"""Performance of a session for its results, with its deviations from ISO 9283's conditions."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from verify.analysis.model import JointErrorModel
from verify.analysis.performance.entries import performance_summary, performance_tables
from verify.analysis.performance.poses import PoseIndices
from verify.analysis.performance.session import Performance, performance
from verify.core.readings import Readings
from verify.core.records import Array, Index
from verify.io.session.keys import RunTable
from verify.io.session.session import Session
from verify.io.toml import decode

CYCLES, PASSAGES, POSES = 30, 10, 5
MAX_UNCERTAINTY_SHARE = 0.25  # of a characteristic, that the uncertainty of measurement may reach
TEMPERATURE_C = (18.0, 22.0)
MIN_DRIFT_S = 8 * 3600.0
MAX_NAMED = 5  # pairs in a warning
MAX_OFF_PLANE = 0.02  # of the poses' extent: off one plane by less is in it


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


def _mean_positions(poses: tuple[PoseIndices, ...]) -> list[dict[str, Any]]:
    if len(poses) != POSES:
        return [{"kind": "poses", "found": len(poses), "standard": POSES}]
    places = np.array([p.commanded[:3, 3] for p in poses])
    centred = places - places.mean(axis=0)
    _, size, axes = np.linalg.svd(centred)
    off = float(np.abs(centred @ axes[2]).max())  # m, from the best plane
    if off <= MAX_OFF_PLANE * size[0]:
        return []
    return [{"kind": "plane", "off_plane_mm": round(off * 1e3, 3)}]


def _uncertain_poses(poses: tuple[PoseIndices, ...]) -> list[dict[str, Any]]:
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


def session_performance(
    session: Session, model: JointErrorModel, offset: float, frame: Array
) -> tuple[dict[str, Any], dict[str, pd.DataFrame], list[str]]:
    """Find and judge the poses and paths that a session names or, where it names none, repeats.

    `offset`, s, is added to the readings' time to get the cameras' clock; `frame` (n,): the pairs'
    numbers. Gives `performance` (null where nothing is repeated) and `performance_reason` (why,
    else null) of summary.json; the tables; and warnings.
    """
    file = session.folder / "session.toml"
    # a simulated one has no folder
    table = decode(file, RunTable)[0] if file.exists() else None
    poses, paths = ((), ()) if table is None else (table.pose, table.path)
    instrument = session.instrument
    found = performance(
        model,
        session.arm,
        Readings(session.encoders.t, session.encoders.q),
        offset,
        named_poses=poses,
        named_paths=paths,
        point=(
            instrument.flange_T_body[:3, 3]
            if instrument is not None and instrument.positions_alone
            else None
        ),
        timed=session.frames.timed,
        frame=frame.astype(np.int64),
    )
    if not isinstance(found, Performance):
        return {"performance": None, "performance_reason": found}, performance_tables(None), []
    listed = condition_deviations(
        found, temperature_c=session.temperature_c, through_encoders=model.through_encoders
    )
    entry = performance_summary(found, listed)
    summary = {"performance": entry, "performance_reason": None}
    return summary, performance_tables(found), list(_outlier_warnings(found))


def _outlier_warnings(found: Performance) -> Iterator[str]:
    if len(found.left_out):
        yield (
            "Repeated poses: left out of AP and RP, as they lie far off the others of their hold "
            f"while the readings stand: pairs {_listed(found.left_out)}."
        )
    for one in found.outlying:
        visits, rp = next((len(p.visits.t), p.repeatability.found.value) for p in found.poses
                          if p.visits.name == one.name)  # fmt: skip
        yield (
            f"Repeated poses: outlying among {visits} visits of {one.name}: "
            f"{_listed(one.visits + 1)} (pairs {_listed(one.pairs)}), up to "
            f"{one.apart[0] * 1e3:.3g} mm off the others. AP and RP = {rp * 1e3:.3g} mm rest on "
            f"them; without them RP = {one.repeatability * 1e3:.3g} mm. Check the instrument and "
            "the arm there before either is quoted."
        )


def _listed(pairs: Index) -> str:
    more = f" and {len(pairs) - MAX_NAMED} more" * (len(pairs) > MAX_NAMED)
    return ", ".join(map(str, pairs[:MAX_NAMED].tolist())) + more
