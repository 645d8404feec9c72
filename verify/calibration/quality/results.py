"""A calibration from boards as results: what `verify calibrate boards` leaves beside rig.toml.

The summary's keys, units in their names; what is not known is null:

    kind                  "calibration"
    tool, inputs, warnings as in a run's summary
    source                path, description
    pairs                 used, corners, refused
    reprojection          rms_px, left_rms_px, right_rms_px, noise_factor, degrees_of_freedom
    stereo                baseline_mm, convergence_deg, position_mm and rotation_vector_deg of the
                          right camera in the left one; each with *_standard_uncertainty_…
    turning               null where the bases stood still; else axes_angle_deg, and its u
    square                stated_mm, stated_standard_uncertainty_mm, found_mm,
                          standard_uncertainty_mm, deviation_mm (of single edges)
    fixed, decisions      what was held, and the sentences that say why
    principal_points      camera, offset_px, distance_px, standard_uncertainty_px, odd, believed
    working_distance_mm, spot_px, length_mm
    accuracy              a distance each: distance_mm, {random,systematic,total}_{lateral,depth,
                          total}_mm in the middle of the view, worst_total_mm anywhere in it,
                          length_{across,depth}_{random,systematic}_um of length_mm
    improve_first         group, help, depth_mm: standard uncertainty of the depth as it is
    doubts, gaps          sentences: what speaks against it; what the boards did not cover
    parameter_correlation parameters, correlation

Tables: parameters, views, residuals, boards, coverage, accuracy, contributions, scene (lines in
space: boards and cameras). Image: rectified, where a pair was given.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from reports import Results
from verify.calibration.origin import DEG, MM, UM, ResultsOrigin
from verify.calibration.quality import accuracy
from verify.calibration.quality.advice import ADVICE, calibration_doubts, coverage_gaps
from verify.calibration.quality.quality import (
    NOISE_GROUP,
    CalibrationQuality,
    draw_rectified,
    judge_calibration,
)
from verify.calibration.quality.tables import tables
from verify.calibration.stereo.records import Calibration, camera_covariance
from verify.core.records import SIDES, Array, Image
from verify.core.rig import Rig


def stereo_geometry(rig: Rig, pan: Array) -> dict[str, Any]:
    """Baseline, convergence, and the right camera's place in the left one, at two pan readings."""

    def relation(moved: Rig) -> Array:
        left = moved.left.rig_T_camera(float(pan[0]))
        left_T_right = np.linalg.inv(left) @ moved.right.rig_T_camera(float(pan[1]))
        position = left_T_right[:3, 3]
        turn = Rotation.from_matrix(left_T_right[:3, :3]).as_rotvec()
        convergence = np.arctan2(-left_T_right[0, 2], left_T_right[2, 2])  # axes that meet: > 0
        return np.array([np.linalg.norm(position), convergence, *position, *turn])

    value, u = _with_uncertainty(relation, rig)
    return {
        "baseline_mm": value[0] * MM,
        "baseline_standard_uncertainty_mm": u[0] * MM,
        "convergence_deg": value[1] * DEG,
        "convergence_standard_uncertainty_deg": u[1] * DEG,
        "position_mm": (value[2:5] * MM).tolist(),
        "position_standard_uncertainty_mm": (u[2:5] * MM).tolist(),
        "rotation_vector_deg": (value[5:8] * DEG).tolist(),
        "rotation_vector_standard_uncertainty_deg": (u[5:8] * DEG).tolist(),
    }


def pan_axes_angle(rig: Rig) -> dict[str, Any]:
    """Angle between the axes that the two bases turn about."""

    def between(moved: Rig) -> Array:
        across = np.linalg.norm(np.cross(moved.left.pan_axis, moved.right.pan_axis))
        return np.array([np.arctan2(across, abs(moved.left.pan_axis @ moved.right.pan_axis))])

    value, u = _with_uncertainty(between, rig)
    return {"axes_angle_deg": value[0] * DEG, "axes_angle_standard_uncertainty_deg": u[0] * DEG}


def _with_uncertainty(function: Callable[[Rig], Array], rig: Rig) -> tuple[Array, Array]:
    """Values (m,) of a function of the rig and their standard uncertainties by its covariance."""
    names, full = camera_covariance(rig)
    slope = accuracy.parameter_derivatives(function, rig, names)
    return function(rig), np.sqrt(np.einsum("pm,pq,qm->m", slope, full, slope))


def calibration_results(
    calibration: Calibration,
    *,
    pan: Array | None = None,
    picture: tuple[Image, Image] | None = None,
    picture_pan: Array | None = None,
    names: Mapping[int, str] | None = None,
    origin: ResultsOrigin | None = None,
) -> Results:
    """Judge a calibration and lay it out for the report.

    Readings of the bases are pan (b, 2), rad, at its pairs, and picture_pan (2,) at the pair that
    is shown rectified; None: the rig's own fixed ones. The names are of the pairs' pictures, by
    frame, as the user knows them.

    Raises:
        ValueError: the rig states no covariance, or `pan` does not fit the pairs.
    """
    quality = judge_calibration(calibration, pan)
    used, board, images = calibration.residuals.used, calibration.board, {}
    if picture is not None:
        images["rectified"] = draw_rectified(calibration.rig, *picture, picture_pan)
    return Results(
        summary={
            **(origin or ResultsOrigin()).summary("calibration"),
            "pairs": {
                "used": len(calibration.frames),
                "corners": int(used.sum()),
                "refused": int((~used).sum()),
            },
            "reprojection": {
                "rms_px": quality.rms[0],
                "left_rms_px": quality.rms[1],
                "right_rms_px": quality.rms[2],
                "noise_factor": calibration.noise,
                "degrees_of_freedom": calibration.degrees_of_freedom,
            },
            "stereo": stereo_geometry(calibration.rig, quality.pan),
            "turning": pan_axes_angle(calibration.rig) if calibration.turning else None,
            "square": _square(calibration),
            "fixed": list(calibration.fixed),
            "decisions": list(calibration.decisions),
            "principal_points": _principal_points(quality),
            **_accuracy(calibration, quality),
            "doubts": list(calibration_doubts(calibration, quality, names)),
            "gaps": list(coverage_gaps(calibration, quality)),
            "parameter_correlation": _correlation(calibration),
        },
        setup={
            "board": {
                "columns": board.columns,
                "rows": board.rows,
                "square_mm": board.square * MM,
                "markers": board.markers,
                "marker_mm": None if board.marker is None else board.marker * MM,
            },
            "image_size_px": list(calibration.rig.image_size),
        },
        tables=tables(calibration, quality),
        images=images,
    )


def _square(calibration: Calibration) -> dict[str, Any]:
    stated = calibration.board.square_standard_uncertainty
    found, u, spread = (x * MM if np.isfinite(x) else None for x in calibration.square_found)
    return {
        "stated_mm": calibration.board.square * MM,
        "stated_standard_uncertainty_mm": None if stated is None else stated * MM,
        "found_mm": found,
        "standard_uncertainty_mm": u,
        "deviation_mm": spread,
    }


def _principal_points(quality: CalibrationQuality) -> list[dict[str, Any]]:
    return [
        {
            "camera": SIDES[point.camera],
            "offset_px": point.offset.tolist(),
            "distance_px": point.distance,
            "standard_uncertainty_px": point.uncertainty,
            "odd": point.odd,
            "believed": point.believed,
        }
        for point in quality.principal_points
    ]


def _accuracy(calibration: Calibration, quality: CalibrationQuality) -> dict[str, Any]:
    entries = []
    for field in quality.fields:
        entry: dict[str, Any] = {"distance_mm": field.distance * MM}
        maps = accuracy.uncertainty_maps(field)
        middle = {name: float(v[len(field.y) // 2, len(field.x) // 2]) for name, v in maps.items()}
        entry |= {name: v if np.isfinite(v) else None for name, v in middle.items()}
        total = maps["total_total_mm"]
        entry["worst_total_mm"] = None if np.isnan(total).all() else float(np.nanmax(total))
        for name, axis in (("across", 0), ("depth", 2)):
            random, systematic = accuracy.length_uncertainty(
                calibration.rig, quality.pan, field.distance, axis, calibration.turning
            )
            entry[f"length_{name}_random_um"] = random * UM
            entry[f"length_{name}_systematic_um"] = systematic * UM
        entries.append(entry)
    group = quality.contributions[0].group
    noise = next(c for c in quality.contributions if c.group == NOISE_GROUP)
    depth = float(np.hypot(noise.alone, noise.without))
    return {
        "working_distance_mm": quality.working_distance * MM,
        "spot_px": accuracy.SPOT_SIGMA,
        "length_mm": accuracy.TEST_LENGTH * MM,
        "accuracy": entries,
        "improve_first": {"group": group, "help": ADVICE[group], "depth_mm": depth * MM},
    }


def _correlation(calibration: Calibration) -> dict[str, Any]:
    given = calibration.rig.covariance
    if given is None:
        return {"parameters": [], "correlation": []}
    free = given.take(np.flatnonzero(given.standard_uncertainty > 0).tolist())
    return {"parameters": list(free.parameters), "correlation": free.correlation.tolist()}
