"""A single camera from pictures of a board.

The adjustment is the stereo rig's (see `bundle`) with the camera in the left one's place, its
frame for the rig's, and no view of the right one. Only the lens and the boards' poses are free.

Views that show too little for a rig still give a lens with its uncertainty; only where even that
means nothing are they refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from verify.board import Board, BoardPair, BoardView
from verify.calibration import (
    initial,
    one_camera_adjust,
    order,
    quality_views,
    refusals,
    robust,
)
from verify.calibration.boards import HELD, stack
from verify.calibration.estimate import Estimate, residuals_of, response
from verify.calibration.one_camera_adjust import (
    ALL_LENS,
    MAY_GO,
    SIDE,
    adjust_good,
    held_names,
    settle_roughly,
)
from verify.calibration.parameters import FOCAL, KEYS, LENS, PRINCIPAL, Corners, State
from verify.calibration.quality import ODD, SURE, PrincipalPoint
from verify.calibration.starting import usable_view
from verify.errors import InputError
from verify.records import Array
from verify.rig import Camera

FEWEST_VIEWS = 3
OPEN = 0.1  # of the focal length: over so wide a range the pictures are no straight function


@dataclass(frozen=True, slots=True)
class OneCamera:
    """A camera's lens, how well it is known, and what the pictures are worth."""

    matrix: Array  # (3, 3), px
    distortion: Array  # (5,), k1, k2, p1, p2, k3 (OpenCV)
    names: tuple[str, ...]  # (p), of fx_px, fy_px, cx_px, cy_px and the coefficients: what moves
    covariance: Array  # (p, p), px and 1; singular where the focal lengths are held equal
    noise: float  # what the corners' stated uncertainty had to be multiplied with
    together: float  # factor on the variances, >= 1: corners of a view err together
    degrees_of_freedom: float  # of the covariance
    rms: float  # px, root mean square distance of the used corners, as OpenCV counts
    refused: int  # corners, as outliers
    view_rms: Mapping[int, float]  # by frame, px
    standing_out: tuple[int, ...]  # frames that fit worse than the others
    left_out: tuple[int, ...]  # frames that show no board, or too little of one
    principal_point: PrincipalPoint
    decisions: tuple[str, ...]  # sentences: the model order chosen, views left out, and why


def calibrate_camera(
    views: Mapping[int, BoardView],
    board: Board,
    image_size: tuple[int, int],
    *,
    lens: Literal["supported", "full"] = "supported",
) -> OneCamera:
    """Find one camera's matrix and distortion from its views of a board.

    Everything is adjusted at once to the corners of all views, weighted by their stated
    covariance. The unit of the board's square does not matter.

    Args:
        views: by frame, what the camera saw of the board.
        board: the pattern.
        image_size: width and height, px.
        lens: "supported": the distortion coefficients and the difference of focal lengths that
            the pictures support; "full": fx, fy and all five coefficients whatever they show.

    Raises:
        InputError: fewer than three views of the board, or views that leave the focal length or
            the principal point open. Its place is "views" or "camera".
    """
    usable = {f: v for f, v in sorted(views.items()) if usable_view(v, board)}
    foreign = initial.foreign(usable, board)
    chosen = {f: v for f, v in usable.items() if f not in foreign}
    _counted(len(chosen))
    corners = stack([BoardPair(f, 0.0, 0.0, v, None) for f, v in chosen.items()], board)
    state = settle_roughly(_start(chosen, board, image_size), corners, MAY_GO)
    rough = one_camera_adjust.estimate(state, corners, MAY_GO, robust.good(state, corners))
    _determined(rough.state, rough.covariance)
    state, used = adjust_good(settle_roughly(state, corners, ()), corners, ())
    found = one_camera_adjust.estimate(state, corners, (), used)
    dropped: tuple[order.Dropped, ...] = ()
    if lens == "supported":
        found, dropped = one_camera_adjust.reduce(found, corners)
    state, used = adjust_good(found.state, corners, held_names(dropped))
    found = one_camera_adjust.estimate(state, corners, held_names(dropped), used)
    left_out = tuple(f for f in sorted(views) if f not in chosen)
    return _record(found, corners, np.array(list(chosen)), dropped, left_out, image_size)


def _counted(count: int) -> None:
    if count < FEWEST_VIEWS:
        found = f"show the board {count} time{'' if count == 1 else 's'}"
        expected = "three are the fewest, ten to twenty are good"
        raise InputError("views", found, expected, refusals.MORE)


def _determined(state: State, covariance: Array) -> None:
    share = float(_shares(state, covariance).max())
    if share < OPEN:
        return
    amount = f"to ± {share:.0%} of the focal length only" if share < 1 else "not at all"
    found = f"shows its focal length or principal point {amount}"
    raise InputError("camera", found, f"± {OPEN:.0%} would be the worst", refusals.MORE)


def _shares(state: State, covariance: Array) -> Array:
    """Standard uncertainties of fx, fy, cx and cy (4,), as shares of the focal length."""
    u = np.sqrt(np.maximum(np.diag(covariance)[: LENS.start], 0.0))
    shares: Array = u / state.left.matrix[0, 0]
    return shares


def _start(seen: Mapping[int, BoardView], board: Board, image_size: tuple[int, int]) -> State:
    rough = initial.rough_lens(dict(seen), board, image_size)
    origin, up = np.zeros(3), np.array([0.0, 1.0, 0.0])
    own = Camera(rough.matrix, rough.distortion, origin, up, 0.0, np.eye(4))
    poses = np.array([rough.poses[frame] for frame in seen])
    return State(own, own, poses, np.zeros((len(poses), 2)))


def _record(
    found: Estimate,
    corners: Corners,
    frames: NDArray[np.int64],
    dropped: tuple[order.Dropped, ...],
    left_out: tuple[int, ...],
    image_size: tuple[int, int],
) -> OneCamera:
    residuals = residuals_of(found, corners, frames)
    each = quality_views.views(residuals)
    full = found.covariance
    if dropped:
        full = full + order.left_open(dropped, response(found, held_names(dropped)))
    _determined(found.state, full)
    full = full[:ALL_LENS, :ALL_LENS]
    camera = found.state.left
    point = judge_principal_point(camera.matrix, full[PRINCIPAL, PRINCIPAL], image_size)
    moves = np.flatnonzero(np.sqrt(np.diag(full)) > HELD)
    return OneCamera(
        matrix=camera.matrix,
        distortion=camera.distortion,
        names=tuple(KEYS[i] for i in moves),
        covariance=full[np.ix_(moves, moves)],
        noise=found.noise,
        together=found.together,
        degrees_of_freedom=min(float(found.degrees_of_freedom), found.together_degrees),
        rms=quality_views.rms(residuals.residual[found.used]),
        refused=int(np.sum(~found.used)),
        view_rms={v.frame: v.rms for v in each},
        standing_out=tuple(v.frame for v in each if v.poor),
        left_out=left_out,
        principal_point=point,
        decisions=(
            *_views_sentences(left_out, int(np.sum(~found.used)), len(corners)),
            *(d.sentence.removeprefix(f"{SIDE} camera: ") for d in dropped),
            *_weak_sentences(found, float(_shares(found.state, full)[FOCAL].max())),
            *_principal_sentences(point),
        ),
    )


def judge_principal_point(
    matrix: Array, covariance: Array, image_size: tuple[int, int]
) -> PrincipalPoint:
    """Say how far the principal point lies from the image's centre, and whether to believe it.

    Args:
        matrix: (3, 3), px, the camera's.
        covariance: (2, 2), px², of cx and cy.
        image_size: width and height, px.
    """
    size = np.array(image_size)
    offset = matrix[:2, 2] - (size - 1) / 2  # pixel centres at whole numbers
    distance = float(np.linalg.norm(offset))
    unit = offset / distance if distance else np.array([1.0, 0.0])
    u = float(np.sqrt(unit @ covariance @ unit))
    odd = bool(np.any(np.abs(offset) > ODD * size))
    return PrincipalPoint(0, offset, distance, u, odd, distance > SURE * u)


def _views_sentences(left_out: tuple[int, ...], refused: int, of: int) -> list[str]:
    said = []
    if left_out:
        named = ", ".join(str(f) for f in left_out)
        said.append(f"left out, as no board of this pattern was found there: {named}.")
    if refused:
        said.append(
            f"{refused} of {of} corners refused, as the others of their views contradict them."
        )
    return said


def _weak_sentences(found: Estimate, focal: float) -> list[str]:
    said = []
    if found.together > 1:
        said.append(
            "corners of a view err together (a board that is not flat, blur): every standard "
            f"uncertainty is {np.sqrt(found.together):.2f} times what single residuals say."
        )
    if focal > refusals.LOOSE:
        said.append(f"the focal length is known to ± {focal:.1%} only. {refusals.MORE}")
    return said


def _principal_sentences(point: PrincipalPoint) -> list[str]:
    if not point.odd:
        return []
    verdict = "believe it" if point.believed else "do not believe it; add boards tilted both ways"
    times = point.distance / (point.uncertainty or np.inf)
    sentence = (
        f"the principal point lies {point.distance:.0f} px off the image's centre, {times:.1f} "
        f"times its standard uncertainty of {point.uncertainty:.1f} px: {verdict}."
    )
    return [sentence]
