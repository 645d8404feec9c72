"""Results of calibrations, interim checks and registrations.

A calibrated pair of webcams: boards placed by a recipe, corners from OpenCV's projection. The
registrations are made by hand.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from reports.results import Results
from tests.support.boards.board_images import picture
from tests.support.boards.fixture import BOARD as ON_BASE
from tests.support.boards.fixture import STATED, board_pairs, doubtful_rig
from tests.support.boards.made_views import BOARD, SIZE, fixed_rig, make_pairs
from tests.support.moved_rig import bumped, seen_by
from tests.support.scene import make_rig
from verify.calibration.check.check import check_board, check_rig
from verify.calibration.check.results import check_results
from verify.calibration.origin import ResultsOrigin
from verify.calibration.quality.results import calibration_results
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.records import Calibration
from verify.core.records import Array, Image

NOISE = 0.05  # px, each coordinate


def place_boards(
    count: int = 20, tilt_deg: float = 35.0, depth: tuple[float, float] = (0.7, 1.3)
) -> Array:
    """Boards spread over the field, (b, 4, 4), rig_T_board, at random, always the same."""
    share = np.random.default_rng(11).random((count, 6))
    placed = np.tile(np.eye(4), (count, 1, 1))
    for pose, s in zip(placed, share, strict=True):
        z = depth[0] + (depth[1] - depth[0]) * s[0]
        angles = (s[1:4] * 2 - 1) * [tilt_deg, tilt_deg, 20.0]
        turn = Rotation.from_euler("xyz", angles, degrees=True)
        reach = np.array([0.70 * z - 0.08, 0.37 * z - 0.06, 0.0])
        middle = [0.0, 0.0, z] + reach * [2 * s[4] - 1, 2 * s[5] - 1, 0.0]
        pose[:3, :3] = turn.as_matrix()
        pose[:3, 3] = middle - turn.apply(BOARD.points.mean(axis=0))
    return placed


@cache
def calibration(seed: int = 3, count: int = 20, tilt_deg: float = 35.0) -> Calibration:
    """Pairs of boards with NOISE at each corner; corners outside the image are not seen."""
    rng, boards = np.random.default_rng(seed), place_boards(count, tilt_deg)
    rig = fixed_rig()
    at_rest = np.tile([rig.left.pan, rig.right.pan], (count, 1))  # and every reading is zero
    pairs = make_pairs(rig, boards, rng, 0 * at_rest, at_rest, sigma=NOISE, stated=NOISE)
    return calibrate(pairs, BOARD, SIZE)


def with_poor_view(found: Calibration, frame: int = 4, camera: int = 1) -> Calibration:
    """Make one view's residuals five times as large, and have two of its corners refused."""
    bad = (found.residuals.camera == camera) & (found.residuals.frame == frame)
    used = found.residuals.used.copy()
    used[np.flatnonzero(bad)[:2]] = False
    residual = np.where(bad[:, None], 5.0, 1.0) * found.residuals.residual
    return replace(found, residuals=replace(found.residuals, residual=residual, used=used))


def pictures(found: Calibration, frame: int = 0) -> tuple[Image, Image]:
    """A chessboard as both cameras would see it, without noise."""
    left, right = (
        picture(found.board, camera, np.linalg.inv(camera.mount) @ found.rig_T_board[frame], None)
        for camera in (found.rig.left, found.rig.right)
    )
    return left, right


INPUTS: Mapping[str, str] = {
    "board.toml": "sha256:" + "3f" * 32,
    "left/000000.png": "sha256:" + "a1" * 32,
    "right/000000.png": "sha256:" + "b2" * 32,
}


def good() -> Results:
    """Everything covered; the cameras turned on their bases."""
    found = calibration(count=24)
    return calibration_results(
        replace(found, turning=True), picture=pictures(found), origin=ResultsOrigin("boards")
    )


def doubtful() -> Results:
    """Few boards, flat ones, one view that stands out, and inputs to list."""
    found = with_poor_view(calibration(count=9, tilt_deg=8.0))
    return calibration_results(
        found, origin=ResultsOrigin("boards", inputs=INPUTS, warnings=("frames.csv: no pan.",))
    )


def held() -> Results:
    rig = doubtful_rig()
    return check_results(
        check_rig(seen_by((rig, STATED), (rig, STATED), 0), rig, STATED), ResultsOrigin("a")
    )


def not_held() -> Results:
    rig, true = doubtful_rig(), bumped(make_rig())["yaw"]
    found = check_rig(seen_by((true, STATED), (rig, STATED), 1), rig, STATED)
    return check_results(found, ResultsOrigin("b", inputs={"rig.toml": "sha256:" + "0" * 64}))


def board() -> Results:
    rig, known = doubtful_rig(), replace(ON_BASE, square_standard_uncertainty=5e-6)
    return check_results(check_board(rig, board_pairs(rig), known))


def motion() -> Results:
    """Joints 1 and 6 hidden, one swept joint."""
    random = np.random.default_rng(4)
    rows = [
        {"frame": f, "camera": camera, "led": "A", "x_px": 400 + 8.0 * f, "y_px": 300.0 + f,
         "residual_x_px": random.normal(0, 0.1), "residual_y_px": random.normal(0, 0.1),
         "used": f != 7}
        for f in range(40) for camera in ("left", "right")
    ]  # fmt: skip
    q = np.linspace(-20, 20, 30)
    three = [0.1, 0.2, 0.3]
    summary = {
        "kind": "registration", "method": "motion", "robot": "iust_6r",
        "source": {"path": "session"}, "registration": "sha256:" + "5c" * 32,
        "pairs": {"used": 40, "left_out": {"too few LEDs identified": 2}},
        "base": {"position_mm": [91.0, 662.0, 1181.0], "standard_uncertainty_mm": three,
                 "rotation_vector_deg": [44.9, 104.7, -93.5], "standard_uncertainty_deg": three,
                 "held": False},
        "leds": [{"name": "A", "x_mm": 61.8, "y_mm": 3.1, "z_mm": 18.0,
                  "u_x_mm": 0.13, "u_y_mm": 0.1, "u_z_mm": None}],
        "leds_held": False,
        "clock": {"offset_s": 0.1372, "standard_uncertainty_s": 0.0002},
        "skew": {"offset_s": 0.0, "standard_uncertainty_s": None},
        "joints": [{"joint": j + 1, "visible_fraction": v}
                   for j, v in enumerate([0.0, 0.04, 0.09, 0.5, 0.95, 0.0])],
        "fit": {"rms_px": 0.14, "fit_rms_px": 0.13, "held_out_rms_px": 0.15, "misfit": 1.2},
        "decisions": ["4 LEDs move together."], "warnings": [],
    }  # fmt: skip
    axes = pd.DataFrame(
        [{"joints": "1 and 2", "angle_deg": 90.1, "angle_table_deg": 90.0, "angle_u_deg": 0.1,
          "distance_mm": 40.3, "distance_table_mm": 40.0, "distance_u_mm": 0.4, "agrees": True},
         {"joints": "2 and 3", "angle_deg": 0.5, "angle_table_deg": 0.0, "angle_u_deg": 0.1,
          "distance_mm": 250.0, "distance_table_mm": 250.0, "distance_u_mm": 0.3, "agrees": False}]
    )  # fmt: skip
    gears = pd.DataFrame([{"joint": 2, "span_deg": 40.0, "gear": 1.001, "gear_u": 0.0004}])
    sweeps = pd.DataFrame(
        {"joint": 2, "frame": range(30), "reading_deg": q, "nonlinearity_deg": 0.01 * np.sin(q)}
    )
    tables = {"residuals": pd.DataFrame(rows), "axes": axes, "gears": gears, "sweeps": sweeps}
    return Results(summary, {"image_size_px": [1280, 720]}, tables)


def fixture() -> Results:
    """A board on the base: nothing is hidden."""
    given = motion()
    pairs = pd.DataFrame(
        [{"frame": f, "x_mm": 0.01, "y_mm": 0.0, "z_mm": -0.02, "rx_deg": 0.001, "ry_deg": 0.0,
          "rz_deg": 0.0, "chi2": 5.2} for f in range(4)]
    )  # fmt: skip
    keep = {k: given.summary[k] for k in ("kind", "robot", "source", "base", "registration")}
    summary = {**keep, "method": "fixture", "pairs": {"used": 4}, "fit": {"rms_px": 0.05}}
    return Results(summary, given.setup, {"pairs": pairs})
