"""A robot's registration as results: what `verify calibrate register` leaves beside rig.toml.

The keys of the summary and the tables are those that `reports.calibration.registration` documents.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from reports import Results
from verify.calibration.axes.table import SweepResult
from verify.calibration.kinematics.placements import placement_uncertainty, target_in_flange
from verify.calibration.kinematics.registration import PosesRegistration
from verify.calibration.origin import DEG, MM, POSE_UNITS, ResultsOrigin
from verify.calibration.registration.fixture import FixtureRegistration
from verify.calibration.registration.records import MotionRegistration
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, SIDES, Array
from verify.core.rig import Rig
from verify.io.session.session import Session


def motion_results(
    found: MotionRegistration,
    *,
    robot: str,
    origin: ResultsOrigin | None = None,
    sweeps: SweepResult | None = None,
    base_held: bool = False,
    leds_held: bool = False,
) -> Results:
    """Lay a registration from motion out for the report, with axes of single joints if swept."""
    stated = {} if found.rig.covariance is None else found.rig.covariance.by_name
    left_out = dict(sorted(Counter(found.left_out.values()).items()))
    summary = {
        **_begin(origin, "motion", robot, found.rig, held=base_held),
        "pairs": {"used": found.pairs_used, "left_out": left_out},
        "leds": _led_entries(found.marker, stated),
        "leds_held": leds_held,
        "clock": _time(found.clock_offset, found.clock_standard_uncertainty),
        "skew": _time(found.skew, found.skew_standard_uncertainty),
        "joints": [
            {"joint": j + 1, "visible_fraction": share, "base_shift_mm_per_deg": shift}
            for j, (share, shift) in enumerate(
                zip(found.visible_fractions.tolist(), _base_shifts(found), strict=True)
            )
        ],
        "fit": {
            "rms_px": found.rms_px,
            "fit_rms_px": found.fit_rms_px,
            "held_out_rms_px": found.held_out_rms_px,
            "misfit": found.misfit,
        },
        "decisions": [*found.decisions, *(sweeps.decisions if sweeps else ())],
        "warnings": [*found.warnings, *(sweeps.warnings if sweeps else ())],
    }
    return Results(
        summary=summary,
        setup={"image_size_px": list(found.rig.image_size)},
        tables={"residuals": _residuals(found), **_sweep_tables(sweeps)},
    )


def fixture_results(found: FixtureRegistration, origin: ResultsOrigin | None = None) -> Results:
    """Lay a registration by a board on the robot's base out for the report."""
    difference = dict(zip(POSE_NAMES, (found.pair_difference * POSE_UNITS).T, strict=True))
    pairs = pd.DataFrame({"frame": found.frames, **difference, "chi2": found.pair_chi2})
    summary = {
        **_begin(origin, "fixture", "a robot by a board on its base", found.rig, held=False),
        "pairs": {"used": len(found.frames), "left_out": {}},
        "leds": [],
        "joints": [],
        "fit": {"rms_px": found.residual_rms_px, "noise": found.noise},
        "decisions": list(found.decisions),
        "warnings": list(found.warnings),
    }
    return Results(
        summary=summary,
        setup={"image_size_px": list(found.rig.image_size)},
        tables={"pairs": pairs},
    )


def poses_results(
    found: PosesRegistration,
    session: Session,
    origin: ResultsOrigin,
    *,
    base_held: bool,
    target_held: bool,
) -> Results:
    """Lay a registration by another instrument's poses out for the report."""
    target = target_in_flange(session, found.fit)
    residual = found.residual * POSE_UNITS
    sizes = [np.linalg.norm(part, axis=1) for part in np.split(residual, 2, axis=1)]
    turned = session.instrument is not None and not session.instrument.positions_alone
    left_out = {"do not belong to the others": len(found.left_out)} if found.left_out else {}
    target_u = placement_uncertainty(found.fit, "tool", 0)
    if not turned:
        target_u[3:] = np.nan
    summary = {
        **_begin(origin, "poses", session.robot, found.rig, held=base_held),
        "pairs": {"used": int(found.fit.used.sum()), "left_out": left_out},
        "target": _base(target, target_u, held=target_held),
        "leds": [],
        "joints": [
            {"joint": j + 1, "visible_fraction": share}
            for j, share in enumerate(found.visible_fractions.tolist())
        ],
        "fit": {"rms_mm": found.rms[0] * MM, "rms_deg": found.rms[1] * DEG if turned else None},
        "decisions": list(found.decisions),
        "warnings": list(found.warnings),
    }
    table = pd.DataFrame(
        {
            "pose": found.frame,
            "residual_mm": sizes[0],
            "residual_deg": sizes[1] if turned else np.nan,
            "used": found.fit.used,
        }
    )
    return Results(summary=summary, setup={}, tables={"poses": table})


def _begin(
    origin: ResultsOrigin | None, method: str, robot: str, rig: Rig, *, held: bool
) -> dict[str, Any]:
    """Begin a summary: what was registered how, and the base with its stated uncertainties."""
    stated = {} if rig.covariance is None else rig.covariance.by_name
    u = np.array([stated.get(f"robot_base.{key}", np.nan) for key in POSE_NAMES])
    begun = (origin or ResultsOrigin()).summary("registration")
    named = {"method": method, "robot": robot, "registration": rig.registration}
    return {**begun, **named, "base": _base(rig.rig_T_base, u, held=held)}


def _base_shifts(found: MotionRegistration) -> list[float | None]:
    """How far a constant offset of each joint moved the base, mm per degree; None: not known."""
    moved = found.rig.absorption
    size = None if moved is None else np.linalg.norm(moved[:3], axis=0) * MM / DEG
    return [None] * len(found.visible_fractions) if size is None else size.tolist()


def _base(rig_T_base: Array, u: Array, *, held: bool) -> dict[str, Any]:
    """A pose and its standard uncertainties (6,), mm and degrees."""
    turn = Rotation.from_matrix(rig_T_base[:3, :3]).as_rotvec(degrees=True)
    return {
        "position_mm": (rig_T_base[:3, 3] * MM).tolist(),
        "rotation_vector_deg": turn.tolist(),
        "standard_uncertainty_mm": u[:3].tolist(),
        "standard_uncertainty_deg": u[3:].tolist(),
        "held": held,
    }


def _led_entries(marker: Marker, stated: Mapping[str, float]) -> list[dict[str, Any]]:
    rows = []
    for name, place in zip(marker.names, (marker.leds * MM).tolist(), strict=True):
        keys = [f"{axis}_mm" for axis in "xyz"]
        row: dict[str, Any] = {"name": name, **dict(zip(keys, place, strict=True))}
        rows.append(row | {f"u_{key}": stated.get(f"led.{name}.{key}") for key in keys})
    return rows


def _time(offset: float, uncertainty: float | None) -> dict[str, Any]:
    return {"offset_s": offset, "standard_uncertainty_s": uncertainty}


def _residuals(found: MotionRegistration) -> pd.DataFrame:
    spots = found.spots
    return pd.DataFrame(
        {
            "frame": spots.frame[spots.pair],
            "camera": [SIDES[c] for c in spots.side.tolist()],
            "led": [found.marker.names[i] for i in spots.led.tolist()],
            "x_px": spots.centre[:, 0],
            "y_px": spots.centre[:, 1],
            "residual_x_px": found.residual[:, 0],
            "residual_y_px": found.residual[:, 1],
            "used": spots.used,
        }
    )


def _sweep_tables(found: SweepResult | None) -> dict[str, pd.DataFrame]:
    if found is None:
        return {}
    axes = pd.DataFrame({"joints": [f"{p.joints[0]} and {p.joints[1]}" for p in found.pairs]})
    for kind, unit, scale in (("angle", "deg", DEG), ("distance", "mm", MM)):
        for name, key in ("", ""), ("_table", "_table"), ("_u", "_uncertainty"):
            values = [getattr(p, f"{kind}{key}") * scale for p in found.pairs]
            axes[f"{kind}{name}_{unit}"] = values
    axes["agrees"] = [pair.agrees for pair in found.pairs]
    gears = [(one.joint, one.span * DEG, one.gear, one.gear_uncertainty) for one in found.joints]
    sweeps = [
        pd.DataFrame(
            {
                "joint": swept.joint,
                "frame": swept.frames,
                "reading_deg": swept.q[:, swept.joint - 1] * DEG,
                "nonlinearity_deg": swept.nonlinearity * DEG,
            }
        )
        for swept in found.joints
    ]
    return {
        "axes": axes,
        "gears": pd.DataFrame(gears, columns=["joint", "span_deg", "gear", "gear_u"]),
        "sweeps": pd.concat(sweeps, ignore_index=True) if sweeps else pd.DataFrame(),
    }
