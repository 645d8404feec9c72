"""From corners in pairs of pictures to the whole stereo rig on its turning bases."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from verify.board import Board, BoardPair
from verify.calibration import bases, flatness, order, refusals, robust, starting
from verify.calibration.covariance import stated
from verify.calibration.estimate import Estimate, board_covariance, estimate, residuals_of, response
from verify.calibration.gauge import FIXED, Model, fixed_names
from verify.calibration.pan import Scatter
from verify.calibration.parameters import NAMES, Corners, lengths
from verify.calibration.records import Calibration
from verify.calibration.square import edges
from verify.records import Array
from verify.rig import Camera, Covariance, Rig

STAGES = 5
HELD = 1e-8  # a parameter that the free directions move by less does not move
Progress = Callable[[int, int], None]


def no_progress(_done: int, _of: int) -> None:
    """Report no progress."""


def calibrate(
    pairs: Sequence[BoardPair],
    board: Board,
    image_size: tuple[int, int],
    *,
    lens: Literal["supported", "full"] = "supported",
    progress: Progress = no_progress,
) -> Calibration:
    """Find both cameras, how they stand to each other and how their bases turn.

    Everything is adjusted at once to the corners of all pairs, weighted by their stated
    covariance. A view that one camera alone has counts for that camera. Bases that turned between
    pairs are found with axis, centre, zero and mount, as far as the readings' range shows them;
    those that did not are fixed by choice (see `gauge`).

    Args:
        pairs: what both cameras saw, and the readings of their bases.
        board: the pattern.
        image_size: width and height, px.
        lens: "supported": the distortion coefficients and the difference of focal lengths that
            the pictures support; "full": fx, fy and all five coefficients whatever they show.
        progress: is told how many of how many stages are done.

    Returns:
        The rig with the full covariance of its parameters, the boards' poses, every residual.

    Raises:
        InputError: no board found, fewer than three pairs, a board turned by 180° in one camera,
            left and right swapped, pairs that do not agree, or boards that leave a focal length
            or principal point open. Its place is "left", "right" or "pairs".
    """
    progress(0, STAGES)
    begin = starting.gather(pairs, board, image_size)
    corners = stack(begin.pairs, board)
    progress(1, STAGES)
    model = Model(begin.bases, order.shortest(), bases.start_precision(begin.bases))
    state = robust.settle_roughly(begin.state, corners, model)
    rough = estimate(state, corners, model, robust.good(state, corners))
    refusals.undetermined(rough)
    progress(2, STAGES)
    model = replace(model, held=(), pan_precision=bases.start_precision(begin.bases, rough.noise))
    state = robust.settle_roughly(rough.state, corners, model)
    state, used = robust.adjust(state, corners, model)
    progress(3, STAGES)
    flat, corners, bow = flatness.straightened(
        estimate(state, corners, model, used), corners, board
    )
    if bow is not None:  # corners that only the bow put off come back
        state, used = robust.adjust(flat.state, corners, model)
        flat, corners, again = flatness.straightened(
            estimate(state, corners, model, used), corners, board
        )
        bow = bow if again is None else again
    found, scatter, loose = bases.settled(flat, corners)
    if scatter is not None:
        refusals.wrong_readings(scatter.deviation)
    dropped: tuple[order.Dropped, ...] = ()
    if lens == "supported":
        found, dropped = order.reduce(found, corners)
    progress(4, STAGES)
    state, used = robust.adjust(found.state, corners, found.model)
    found = estimate(state, corners, found.model, used)
    if bow is not None:
        bow = flatness.restated(bow, found, corners, board)
    decisions = (
        *begin.notes,
        *loose,
        *(d.sentence for d in dropped),
        *bases.sentences(found, scatter, corners.pan),
        *(() if bow is None else (bow.sentence,)),
        *_sentences(found, board),
    )
    progress(STAGES, STAGES)
    return _calibration(found, corners, begin, board, image_size, dropped, scatter, decisions, bow)


def stack(pairs: Sequence[BoardPair], board: Board) -> Corners:
    """Lay the corners of all views end to end, sorted by pair, left before right."""
    views = [
        (i, side, view)
        for i, pair in enumerate(pairs)
        for side, view in enumerate((pair.left, pair.right))
        if view is not None
    ]
    corner = np.concatenate([v.corner for _, _, v in views])
    spread = np.concatenate([v.covariance for _, _, v in views])
    return Corners(
        camera=np.concatenate([np.full(len(v), side) for _, side, v in views]),
        board=np.concatenate([np.full(len(v), i) for i, _, v in views]),
        corner=corner,
        point=board.points[corner],
        seen=np.concatenate([v.centre for _, _, v in views]),
        root=np.linalg.inv(np.linalg.cholesky(spread)),
        uncertainty=np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2),
        pan=np.array([[p.pan_left, p.pan_right] for p in pairs]),
    )


def _calibration(
    found: Estimate,
    corners: Corners,
    begin: starting.Starting,
    board: Board,
    image_size: tuple[int, int],
    dropped: Sequence[order.Dropped],
    scatter: Scatter | None,
    decisions: tuple[str, ...],
    bow: flatness.Bow | None,
) -> Calibration:
    full, boards = _covariances(found, board, dropped, bow)
    frames = np.array([p.frame for p in begin.pairs])
    left, right = (
        _with_reading(camera, base, corners.pan[:, side], scatter)
        for side, (camera, base) in enumerate(
            zip(found.state.cameras, found.model.bases, strict=True)
        )
    )
    rig = Rig(
        image_size=image_size,
        left=left,
        right=right,
        rig_T_base=np.full((4, 4), np.nan),
        base_source="",
        covariance=_named(found, full, dropped),
    )
    residuals = residuals_of(found, corners, frames)
    return Calibration(
        rig=rig,
        board=board,
        frames=frames,
        rig_T_board=found.state.boards,
        board_covariance=boards,
        residuals=residuals,
        noise=found.noise,
        degrees_of_freedom=found.degrees_of_freedom,
        fixed=fixed_names(found.model),
        decisions=decisions,
        square_found=edges(found.state, corners, found.used, board),
        turning=begin.bases != (FIXED, FIXED),
    )


def _covariances(
    found: Estimate,
    board: Board,
    dropped: Sequence[order.Dropped],
    bow: flatness.Bow | None,
) -> tuple[Array, Array]:
    """Of the rig's parameters (44, 44) and of the boards' poses (b, 6, 6)."""
    full = found.covariance
    if dropped:
        full = full + order.left_open(dropped, response(found, tuple(d.name for d in dropped)))
    if bow is not None:  # fitted along, so not known exactly
        full = full + found.together * bow.response @ bow.covariance @ bow.response.T
    boards = board_covariance(found, full)
    if board.square_standard_uncertainty:  # all lengths grow with the squares, together
        share = board.square_standard_uncertainty / board.square
        scaled = share * lengths(found.state)
        full = full + np.outer(scaled, scaled)
        shift = share * found.state.boards[:, :3, 3]
        boards = boards.copy()
        boards[:, :3, :3] += shift[:, :, None] * shift[:, None, :]
    return full, boards


def _named(found: Estimate, full: Array, dropped: Sequence[order.Dropped]) -> Covariance:
    """What moves at all, as rig.toml states it."""
    moves = np.linalg.norm(found.basis, axis=1) > HELD
    uncertain = {d.name for d in dropped if d.remaining}
    chosen = [i for i, n in enumerate(NAMES) if moves[i] or n in uncertain]
    degrees = min(float(found.degrees_of_freedom), found.together_degrees)
    return stated([NAMES[i] for i in chosen], full[np.ix_(chosen, chosen)], degrees)


def _with_reading(camera: Camera, base: str, readings: Array, scatter: Scatter | None) -> Camera:
    """State the reading of a base, and how far it may be off where the base turned."""
    if base == FIXED:
        return replace(camera, pan=float(readings[0]))
    deviation = None if scatter is None else scatter.deviation
    return replace(camera, pan=float(np.median(readings)), pan_standard_uncertainty=deviation)


def _sentences(found: Estimate, board: Board) -> list[str]:
    said = []
    refused = int(np.sum(~found.used))
    if refused:
        said.append(f"{refused} of {len(found.used)} corners refused, as the others of their views "
                    "contradict them.")  # fmt: skip
    if found.together > 1:
        said.append(
            "corners of a pair err together (a board that bends in the hand, blur): every standard "
            f"uncertainty is {np.sqrt(found.together):.2f} times what single residuals say."
        )
    if board.square_standard_uncertainty is None:
        said.append("The square's size carries no uncertainty: it is taken as exact, and with it "
                    "every length.")  # fmt: skip
    return said
