"""A plan as tables: for a controller, and for the report's pictures."""

from typing import Any

import numpy as np
import pandas as pd

from verify.planning.plan import Prediction
from verify.planning.skeleton import skeleton
from verify.planning.sources import sources
from verify.planning.timing import PERIOD, Timed
from verify.planning.wishes import Bench
from verify.records import Array, Measurement

DRAWN_ARMS = 6  # of the poses, in the picture of the path
FLANGE_PERIOD = 0.25  # s between the points of the flange's way


def trajectory(timed: Timed) -> pd.DataFrame:
    """The motion in even steps: t_s, q1_deg…, and the pose at which the arm rests, from 1."""
    t = np.append(np.arange(0.0, timed.duration, PERIOD), timed.duration)
    rest = [None if k is None else k + 1 for k in timed.resting(t)]
    table = pd.DataFrame({"t_s": t, **_angles(timed.q(t))})
    table["pose"] = pd.array(rest, dtype="Int64")
    return table


def poses(timed: Timed) -> pd.DataFrame:
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


def pairs(predicted: Prediction) -> pd.DataFrame:
    """What becomes of each pair."""
    seen = predicted.foreseen
    columns: dict[str, Any] = {
        "frame": np.arange(len(seen.t)),
        "t_s": seen.t,
        "status": [m.status for m in seen.measurements],
        **_angles(seen.q),
    }
    return pd.DataFrame(columns)


def spots(measurements: list[Measurement], bench: Bench) -> pd.DataFrame:
    """Every LED image of every pair that was measured."""
    rows = [
        (m.frame, camera, bench.marker.names[led], x, y)
        for m in measurements
        for camera, sighting in (("left", m.left), ("right", m.right))
        if sighting is not None
        for led, (x, y) in zip(sighting.led.tolist(), sighting.centre.tolist(), strict=True)
    ]
    return pd.DataFrame(rows, columns=["frame", "camera", "led", "x_px", "y_px"])


def arm(timed: Timed, bench: Bench) -> pd.DataFrame:
    """The flange's way, and the links at some of the poses; robot's base frame."""
    bones = skeleton(bench.arm)
    t = np.append(np.arange(0.0, timed.duration, FLANGE_PERIOD), timed.duration)
    flange = bones.frames(timed.q(t))[:, -1, :3, 3] * 1e3
    rows = [("flange", 0, *place) for place in flange.tolist()]
    stops = [stop.q for stop in timed.stops if stop.pose is not None]
    some = np.unique(np.linspace(0, len(stops) // 2, DRAWN_ARMS).astype(int))
    points = bones.points(bones.frames(np.array([stops[k] for k in some])))
    for number, arm in enumerate(points * 1e3, start=1):
        rows += [("arm", number, *place) for place in arm.tolist()]
    return pd.DataFrame(rows, columns=["what", "number", "x_mm", "y_mm", "z_mm"])


def cameras(bench: Bench) -> pd.DataFrame:
    """Where the cameras stand and look; robot's base frame."""
    base_T_rig = np.linalg.inv(bench.rig.rig_T_base)
    rows = []
    for name, camera in (("left", bench.rig.left), ("right", bench.rig.right)):
        placed = base_T_rig @ camera.rig_T_camera(camera.pan)
        rows.append((name, *(placed[:3, 3] * 1e3).tolist(), *placed[:3, 2].tolist()))
    return pd.DataFrame(
        rows, columns=["camera", "x_mm", "y_mm", "z_mm", "axis_x", "axis_y", "axis_z"]
    )


def shown(predicted: Prediction) -> pd.DataFrame:
    """Every kind of fault of every joint."""
    rows = [
        (j + 1, one.name, one.unit, u, smallest)
        for one in predicted.shown
        for j, (u, smallest) in enumerate(
            zip(
                (one.standard_uncertainty / one.scale).tolist(),
                (one.detectable / one.scale).tolist(),
                strict=True,
            )
        )
    ]
    return pd.DataFrame(
        rows, columns=["joint", "kind", "unit", "standard_uncertainty", "minimum_detectable"]
    )


def sources_table(predicted: Prediction) -> pd.DataFrame:
    """What each joint's uncertainty is made of."""
    rows = [
        (j + 1, one.name, u)
        for one in sources(predicted.foreseen, predicted.judged)
        for j, u in enumerate(np.rad2deg(one.share).tolist())
    ]
    return pd.DataFrame(rows, columns=["joint", "source", "standard_uncertainty_deg"])


def _angles(q: Array) -> dict[str, Array]:
    return {f"q{j + 1}_deg": np.rad2deg(q[:, j]) for j in range(q.shape[1])}
