"""A single camera from pictures of a board.

The adjustment is the stereo rig's (see `bundle`) with the camera in the left one's place, its
frame for the rig's, and no view of the right one. Only the lens and the boards' poses are free.

Views that show too little for a rig still give a lens with its uncertainty; only where even that
means nothing are they refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from verify.board import Board, BoardPair, BoardView
from verify.calibration import (
    bundle,
    follow,
    gauge,
    initial,
    order,
    quality_views,
    refusals,
    robust,
)
from verify.calibration.boards import HELD, stack
from verify.calibration.estimate import FINEST_PX, Estimate, _together, response
from verify.calibration.gauge import FIXED, FOCAL_TIE, LENS_KEYS, Model
from verify.calibration.parameters import FOCAL, KEYS, LENS, PRINCIPAL, WIDTH, Corners, State, moved
from verify.calibration.quality import ODD, SURE, PrincipalPoint
from verify.calibration.records import Residuals
from verify.calibration.starting import _shown
from verify.errors import InputError
from verify.records import Array
from verify.rig import Camera

SIDE = "left"  # whose place the camera takes
FEWEST_VIEWS = 3
OPEN = 0.1  # of the focal length: over so wide a range the pictures are no straight function
ALL_LENS = LENS.stop  # fx, fy, cx, cy and the coefficients
NOT_THERE = tuple(name for name in order.shortest() if not name.startswith(SIDE))
MAY_GO = tuple(name for name in order.shortest() if name.startswith(SIDE))


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
    usable = {f: v for f, v in sorted(views.items()) if _shown(v, board)}
    foreign = initial.foreign(usable, board)
    chosen = {f: v for f, v in usable.items() if f not in foreign}
    _counted(len(chosen))
    corners = stack([BoardPair(f, 0.0, 0.0, v, None) for f, v in chosen.items()], board)
    state = _settle_roughly(_start(chosen, board, image_size), corners, MAY_GO)
    rough = _estimate(state, corners, MAY_GO, robust.good(state, corners))
    _determined(rough.state, rough.covariance)
    state, used = _refuse(_settle_roughly(state, corners, ()), corners, ())
    found = _estimate(state, corners, (), used)
    dropped: tuple[order.Dropped, ...] = ()
    if lens == "supported":
        found, dropped = _reduce(found, corners)
    state, used = _refuse(found.state, corners, _held(dropped))
    found = _estimate(state, corners, _held(dropped), used)
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


def _held(dropped: tuple[order.Dropped, ...]) -> tuple[str, ...]:
    return tuple(d.name for d in dropped)


def _rows(held: tuple[str, ...]) -> tuple[Array, dict[str, int]]:
    """What must stay 0 of a step: all but this camera's lens, and what is held of that."""
    unit = np.eye(2 * WIDTH)
    rows = [*unit[ALL_LENS:]]
    place: dict[str, int] = {}
    for name in held:
        key = name.partition(".")[2]
        place[name] = len(rows)
        rows.append(unit[1] - unit[0] if key == FOCAL_TIE else unit[LENS][LENS_KEYS.index(key)])
    return np.array(rows), place


def _model(held: tuple[str, ...]) -> Model:
    return Model((FIXED, FIXED), (*NOT_THERE, *held))


def _with_held(state: State, rows: Array) -> State:
    """Bring the lens to where held coefficients are 0 and tied focal lengths equal."""
    camera, lens = state.left, np.zeros(2 * WIDTH)
    lens[:ALL_LENS] = *camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], *camera.distortion
    change = -np.linalg.pinv(rows) @ (rows @ lens)
    return replace(state, left=moved(camera, change[:WIDTH]))


def _adjust(
    state: State,
    corners: Corners,
    held: tuple[str, ...],
    weight: Array,
    iterations: int = bundle.ITERATIONS,
) -> State:
    """Find the lens and the poses of least squares, as `bundle.adjust` does for a rig."""
    rows, _ = _rows(held)
    basis, model = gauge.free_directions(rows), _model(held)
    state = _with_held(state, rows)
    here, damping = bundle.cost(state, corners, model, weight), 1e-4
    for _ in range(iterations):
        trial, promised = _stepped(state, corners, model, basis, weight, damping)
        there = bundle.cost(trial, corners, model, weight)
        gained = here - there
        if gained >= 0:
            state, here, damping = trial, there, damping / 10
        else:
            damping *= 10
        if promised < bundle.CONVERGED and gained < bundle.CONVERGED:
            break
    return state


def _stepped(
    state: State, corners: Corners, model: Model, basis: Array, weight: Array, damping: float
) -> tuple[State, float]:
    """One damped step, and by how much it should lower the cost."""
    system = bundle.normal(state, corners, model, weight, damping)
    full = system.information.sum(axis=0) + damping * np.diag(system.diagonal)
    matrix, gradient = basis.T @ full @ basis, system.gradient.sum(axis=0)
    scale = 1 / np.sqrt(np.diag(matrix))
    factor = cho_factor(matrix * np.outer(scale, scale) + 1e-14 * np.eye(len(matrix)))
    change = basis @ (scale * cho_solve(factor, scale * (basis.T @ gradient)))
    straight = np.einsum("bij,bj->bi", system.own, system.own_gradient)
    promised = float(gradient @ change + np.sum(system.own_gradient * straight))
    return follow.step(state, corners, change, straight - system.shared @ change), promised


def _settle_roughly(state: State, corners: Corners, held: tuple[str, ...]) -> State:
    """Adjust with Cauchy's weights, so that no single corner steers the start."""
    before = np.inf
    for _ in range(robust.ROUNDS):
        squares = bundle.distances(state, corners)
        width = robust.CAUCHY**2 * max(robust.scale(squares), 1e-12)
        state = _adjust(state, corners, held, 1 / (1 + squares / width), iterations=4)
        now = float(np.sum(np.log1p(bundle.distances(state, corners) / width)))
        if abs(before - now) < robust.SETTLED * now:
            break
        before = now
    return state


def _refuse(
    state: State, corners: Corners, held: tuple[str, ...]
) -> tuple[State, NDArray[np.bool_]]:
    """Adjust on the corners that are good, and say which those are, as `robust.adjust` does."""
    used = robust.good(state, corners)
    for _ in range(3):
        state = _adjust(state, corners, held, used.astype(float))
        again = robust.good(state, corners)
        if np.array_equal(again, used):
            break
        used = again
    return state, used


def _estimate(
    state: State, corners: Corners, held: tuple[str, ...], used: NDArray[np.bool_]
) -> Estimate:
    """Take stock of an adjusted state, as `estimate.estimate` does for a rig."""
    model, weight = _model(held), used.astype(float)
    system = bundle.normal(state, corners, model, weight)
    rows, place = _rows(held)
    basis = gauge.free_directions(rows)
    degrees = 2 * int(used.sum()) - basis.shape[1] - 6 * len(state.boards)
    squares = bundle.cost(state, corners, model, weight)
    finest = FINEST_PX / float(np.median(corners.uncertainty))
    noise = max(float(np.sqrt(squares / max(degrees, 1))), finest)
    together, own_degrees = _together(system, basis, noise)
    return Estimate(
        state, model, used, system, rows, place, basis, noise, degrees, together, own_degrees
    )


def _reduce(found: Estimate, corners: Corners) -> tuple[Estimate, tuple[order.Dropped, ...]]:
    """Take away what the pictures do not support, one at a time, by the rule of `order`."""
    gone: tuple[order.Dropped, ...] = ()
    while (unsupported := next(order._unsupported(found), None)) is not None:
        gone = (*gone, unsupported)
        weight = found.used.astype(float)
        state = _adjust(found.state, corners, _held(gone), weight, order.REFIT)
        found = _estimate(state, corners, _held(gone), found.used)
    return found, gone


def _record(
    found: Estimate,
    corners: Corners,
    frames: NDArray[np.int64],
    dropped: tuple[order.Dropped, ...],
    left_out: tuple[int, ...],
    image_size: tuple[int, int],
) -> OneCamera:
    residuals = Residuals(
        camera=corners.camera,
        frame=frames[corners.board],
        corner=corners.corner,
        seen=corners.seen,
        residual=corners.seen - bundle.predict(found.state, corners),
        uncertainty=corners.uncertainty * found.noise,
        used=found.used,
    )
    each = quality_views.views(residuals)
    full = found.covariance
    if dropped:
        full = full + order.left_open(dropped, response(found, _held(dropped)))
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
