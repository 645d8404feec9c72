"""Where a board stands, seen by a calibrated rig: each pair of views as one measured pose.

A board is a marker with many points, so what is known of measured poses (systematics.py) serves
it as well. The fit differs from the LEDs' (pose.py): nothing moves between the two pictures, so
corners are independent of one another and a board of hundreds of them costs no dense matrix.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from verify.analysis.least_squares import gauss_newton
from verify.core.fiducials import Board, BoardPair, BoardView, Marker, unnamed_marker
from verify.core.records import Array, Flags, Measurement, Pose, Sighting, rigid_transform
from verify.core.rig import Rig
from verify.errors import InputError
from verify.measurement.pose import SightingStack, perturb, predict, stack_sightings
from verify.measurement.systematics import Systematics, spot_columns
from verify.measurement.triangulation import fit_rigid, triangulate

MIN_CORNERS = 6  # in one view: a plane's pose has six unknowns, and something must be left over
MAX_CORNER_CHI2 = 20.0  # chi² of one corner, 2 degrees of freedom: 5e-5 false rejections
MODEL_ERROR_PX = 0.05  # print, lens model and corner finder: what a corner may miss beside noise
MAX_REJECTED_SHARE = 0.1  # of the corners: beyond that it is not single corners that are wrong
MAX_ITERATIONS = 25
TOL_STEP = 1e-10  # m and rad: far below what pixels allow


def board_marker(board: Board) -> Marker:
    """The board's corners as points of a body, named by their number."""
    return unnamed_marker(board.points, board.square)


def board_poses(
    rig: Rig, pairs: Sequence[BoardPair], board: Board, parameters: Systematics | None = None
) -> list[Measurement]:
    """Measure the board's pose in each pair; `rig_T_flange` is rig_T_board here.

    Returns one measurement a usable pair, by maximum likelihood on the corners of both images. With
    `parameters` single corners are left out that the others contradict, whatever those are off by
    within their uncertainty. The robot's place is not used. InputError: no pose of the board comes
    near the pictures by this rig.
    """
    shown = [p for p in pairs if max(len(p.left or ()), len(p.right or ())) >= MIN_CORNERS]
    try:
        return [_measure_pair(rig, pair, board, parameters) for pair in shown]
    except np.linalg.LinAlgError as error:  # behind the cameras, or at infinity
        found, remedy = "this rig cannot have taken them", "Give the rig.toml of these cameras."
        raise InputError("pictures", found, "the board stands before both", remedy) from error


def _measure_pair(
    rig: Rig, pair: BoardPair, board: Board, parameters: Systematics | None
) -> Measurement:
    left, right = _sighting(pair.left, pair.pan_left), _sighting(pair.right, pair.pan_right)
    seen = len(np.union1d(left.led, right.led))
    views = stack_sightings(left, right, rig, board.points)
    total = views.covariance + MODEL_ERROR_PX**2 * np.eye(2)
    keep = np.ones(len(views.centre), dtype=bool)
    start = _start(rig, left, right, board.points)
    while True:
        pose = _fit_pose(views, keep, start)
        measured = Measurement(pair.frame, 0.0, "measured", seen, pose, left, right)
        if parameters is None or (~keep).sum() >= MAX_REJECTED_SHARE * len(keep):
            return measured
        left_over, _ = residual_beside(measured, parameters, rig, board_marker(board))
        # chi² of each corner in its noise and what a good one may miss, (s,)
        solved = np.linalg.solve(total, left_over[:, :, None])[:, :, 0]
        size = np.where(keep, np.sum(left_over * solved, axis=1), 0.0)
        if size.max() < MAX_CORNER_CHI2:
            return measured
        keep[int(np.argmax(size))] = False
        start = pose.rig_T_flange


def residual_beside(
    measured: Measurement, parameters: Systematics, rig: Rig, marker: Marker
) -> tuple[Array, float]:
    """Residuals (s, 2), px, and chi² of a board's pose, with rig and pan errors fitted beside it.

    With their columns S of unit variance, the corners' weights W and noise N, derivatives J by the
    pose and its gain K = C J' W, of the residuals r remain

        left   r - (S - J K S) a     a = (1 + S' (W - K' C^-1 K) S)^-1 S' W r
        chi²   r' W r - r' W S a

    Residuals of corners that were left out are not carried over.
    """
    pose, left, right = measured.pose, measured.left, measured.right
    if pose is None or left is None or right is None:
        raise ValueError("the pair was not measured")
    moved = spot_columns(parameters, rig, marker, left, right, pose.rig_T_flange, pose.sensitivity)
    noise = np.concatenate([left.covariance, right.covariance])
    weight = np.linalg.inv(noise) * (~pose.rejected)[:, None, None]
    weighted = (weight @ moved.reshape(len(weight), 2, -1)).reshape(moved.shape)
    by_pose = noise @ pose.gain.T.reshape(len(noise), 2, -1) @ np.linalg.inv(pose.covariance_pixels)
    free = moved - by_pose.reshape(len(moved), -1) @ (pose.gain @ moved)
    pull = weighted.T @ pose.residual.reshape(-1)
    fitted = np.linalg.solve(np.eye(len(pull)) + weighted.T @ free, pull)
    return pose.residual - (free @ fitted).reshape(-1, 2), pose.chi2 - float(pull @ fitted)


def _sighting(view: BoardView | None, pan: float) -> Sighting:
    if view is None:
        view = BoardView(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    n = len(view)
    still = np.zeros(n), np.zeros((n, 2)), np.zeros((n, 3))  # peak, velocity, lever
    return Sighting(view.corner, view.centre, view.covariance, 0.0, pan, *still)


def _start(rig: Rig, left: Sighting, right: Sighting, points: Array) -> Array:
    """rig_T_board in closed form: triangulated corners, or the one camera's own view."""
    both, of_left, of_right = np.intersect1d(left.led, right.led, return_indices=True)
    if len(both) >= MIN_CORNERS:
        seen = left.centre[of_left], right.centre[of_right]
        placed, _ = triangulate(rig.left, rig.right, left.pan, right.pan, *seen)
        good = np.isfinite(placed).all(axis=1)
        if good.sum() >= MIN_CORNERS:
            return fit_rigid(placed[good], points[both[good]])
    camera, view = (rig.left, left) if len(left) >= len(right) else (rig.right, right)
    xy = camera.normalise(view.centre)
    # of the two poses that a plane's perspective nearly shares, OpenCV gives the better one
    _, turn, shift = cv2.solvePnP(
        points[view.led], xy, np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
    )
    camera_T_board = rigid_transform(cv2.Rodrigues(turn)[0], shift[:, 0])
    return camera.rig_T_camera(view.pan) @ camera_T_board


def _fit_pose(views: SightingStack, keep: Flags, start: Array) -> Pose:
    weight = np.linalg.inv(views.covariance) * keep[:, None, None]

    def solve_step(pose: Array) -> tuple[Array, tuple[Array, Array, Array, Array]]:
        pixels, by_point, by_pose = predict(views, pose)
        residual = views.centre - pixels
        weighted = weight @ by_pose  # (s, 2, 6)
        covariance = np.linalg.inv(np.einsum("sia,sib->ab", by_pose, weighted))
        step = covariance @ np.einsum("sia,si->a", weighted, residual)
        return step, (covariance, covariance @ weighted.reshape(-1, 6).T, by_point, residual)

    pose, (covariance, gain, by_point, residual) = gauss_newton(
        start, solve_step, perturb, max_iterations=MAX_ITERATIONS, tol_step=TOL_STEP
    )
    return Pose(
        rig_T_flange=pose,
        covariance_pixels=covariance,
        covariance_alignment=np.zeros((6, 6)),
        twist=np.zeros(6),
        acceleration_prior=(0.0, 0.0),
        determined=np.eye(6),
        gain=gain,
        sensitivity=by_point,
        curvature=np.zeros_like(residual),
        residual=residual,
        spot_uncertainty=np.sqrt(np.trace(views.covariance, axis1=1, axis2=2) / 2),
        rejected=~keep,
        consistent=True,
        chi2=float(np.einsum("si,sij,sj->", residual, weight, residual)),
        degrees_of_freedom=int(2 * keep.sum() - 6),
    )
