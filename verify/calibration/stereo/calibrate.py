"""From corners in pairs of pictures to the whole stereo rig on its turning bases.

The pairs that a calibration rests on, and where its adjustment begins.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from verify.calibration.stereo import model_selection, pan_bases, refusals, robust, start
from verify.calibration.stereo import model_selection as stereo_model_selection
from verify.calibration.stereo import pan_bases as stereo_pan_bases
from verify.calibration.stereo.estimate import (
    Estimate,
    board_covariance,
    collect_residuals,
    estimate_state,
    held_response,
)
from verify.calibration.stereo.gauge import BASE_FIXED, AdjustmentModel, fixed_names
from verify.calibration.stereo.pan_bases import PanScatter
from verify.calibration.stereo.parameters import (
    PARAMETER_NAMES,
    SIDES,
    BundleState,
    CornerStack,
    length_parameters,
)
from verify.calibration.stereo.records import Calibration, state_covariance
from verify.calibration.stereo.robust import square_edges
from verify.calibration.stereo.start import relate_cameras
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import Array
from verify.core.rig import Camera, Covariance, Rig

MIN_CORNERS = 6  # twelve coordinates for the six of a pose: below that a view says little
MIN_EXTENT = 0.5  # squares, second extent of the corners seen: on one line they fix no pose


@dataclass(frozen=True, slots=True)
class BundleStart:
    """What the adjustment begins with."""

    pairs: tuple[BoardPair, ...]  # those that are used, with the views that are
    state: BundleState
    bases: tuple[str, str]
    notes: tuple[str, ...]  # what was left out and why


def gather_pairs(
    pairs: Sequence[BoardPair], board: Board, image_size: tuple[int, int]
) -> BundleStart:
    """Choose the pairs to be used and find start values.

    Raises:
        InputError: as `boards.calibrate` says, but for boards that leave a lens open.
    """
    usable, notes = _drop_foreign([_usable(p, board) for p in pairs], board)
    _count_pairs(usable)
    lenses = [start.start_lens(_views(usable, side), board, image_size) for side in (0, 1)]
    readings = np.array([[p.pan_left, p.pan_right] for p in usable])
    kinds = pan_bases.base_kinds(readings)
    relation = relate_cameras(lenses[0].poses, lenses[1].poses, board, readings, kinds)
    frames = [p.frame for p in usable]
    refusals.refuse_half_turned(relation, [lens.poses for lens in lenses], frames)
    both = sum(p.left is not None and p.right is not None for p in usable)
    refusals.refuse_inconsistent(
        relation, both, kinds != (BASE_FIXED, BASE_FIXED), four_fold=board.four_fold
    )
    refusals.refuse_swapped(relation)
    strangers = sorted(set(relation.strangers) - set(relation.quarter_turned))
    if strangers:
        named = refusals.list_pairs([frames[i] for i in strangers])
        notes.append(f"{named} left out: the cameras stand otherwise there than in the others.")
    if relation.quarter_turned:
        named = refusals.list_pairs([frames[i] for i in relation.quarter_turned])
        notes.append(
            f"{named} left out: one camera numbers the board's corners a quarter turn from the "
            "other, which a square board of even counts cannot tell; hold it upright."
        )
    places = [
        i
        for i, pair in enumerate(usable)
        if i not in relation.strangers and not (pair.left is None and pair.right is None)
    ]
    kept = tuple(usable[i] for i in places)
    _count_pairs(kept)
    state = start.start_state(lenses, relation, readings, places, kinds)
    return BundleStart(kept, state, kinds, tuple(notes))


def _views(pairs: Sequence[BoardPair], side: int) -> dict[int, BoardView]:
    return {i: v for i, p in enumerate(pairs) if (v := (p.left, p.right)[side]) is not None}


def _drop_foreign(pairs: list[BoardPair], board: Board) -> tuple[list[BoardPair], list[str]]:
    """Drop the views in which something else was taken for the board, and say so."""
    notes = []
    for side, name in enumerate(SIDES):
        out = start.foreign_views(_views(pairs, side), board)
        for i in out:
            pairs[i] = replace(pairs[i], left=None) if side == 0 else replace(pairs[i], right=None)
        if out:
            named = refusals.list_pairs([pairs[i].frame for i in out])
            notes.append(
                f"{name} camera: {named} left out, as what was found there is no picture of the "
                "board."
            )
    return pairs, notes


def _usable(pair: BoardPair, board: Board) -> BoardPair:
    return replace(pair, left=usable_view(pair.left, board), right=usable_view(pair.right, board))


def usable_view(view: BoardView | None, board: Board) -> BoardView | None:
    """Take a view whose corners fix a board's pose; None: too few of them, or all on one line."""
    if view is None or len(view) < MIN_CORNERS:
        return None
    points = board.points[view.corner, :2]
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return view if extent[1] > MIN_EXTENT * board.square else None


def _count_pairs(pairs: Sequence[BoardPair]) -> None:
    refusals.refuse_unseen(
        left=sum(p.left is not None for p in pairs),
        right=sum(p.right is not None for p in pairs),
        both=sum(p.left is not None and p.right is not None for p in pairs),
        pairs=len(pairs),
    )


N_STAGES = 5
TOL_HELD = 1e-8  # a parameter that the free directions move by less does not move
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
    progress(0, N_STAGES)
    begin = gather_pairs(pairs, board, image_size)
    corners = stack_corners(begin.pairs, board)
    progress(1, N_STAGES)
    model = AdjustmentModel(
        begin.bases,
        stereo_model_selection.shortest_model(),
        stereo_pan_bases.start_precision(begin.bases),
    )
    state = robust.adjust_cauchy(begin.state, corners, model)
    rough = estimate_state(state, corners, model, robust.good_corners(state, corners))
    refusals.refuse_undetermined(rough)
    progress(2, N_STAGES)
    model = replace(
        model, held=(), pan_precision=stereo_pan_bases.start_precision(begin.bases, rough.noise)
    )
    state = robust.adjust_cauchy(rough.state, corners, model)
    state, used = robust.adjust_robust(state, corners, model)
    progress(3, N_STAGES)
    flat, corners, bow = model_selection.fit_bow(
        estimate_state(state, corners, model, used), corners, board
    )
    if bow is not None:  # corners that only the bow put off come back
        state, used = robust.adjust_robust(flat.state, corners, model)
        flat, corners, again = model_selection.fit_bow(
            estimate_state(state, corners, model, used), corners, board
        )
        bow = bow if again is None else again
    found, scatter, loose = stereo_pan_bases.settle_bases(flat, corners)
    if scatter is not None:
        refusals.refuse_wrong_readings(scatter.deviation)
    dropped: tuple[stereo_model_selection.DroppedCoefficient, ...] = ()
    if lens == "supported":
        found, dropped = stereo_model_selection.reduce_model(found, corners)
    progress(4, N_STAGES)
    state, used = robust.adjust_robust(found.state, corners, found.model)
    found = estimate_state(state, corners, found.model, used)
    if bow is not None:
        bow = model_selection.restate_bow(bow, found, corners, board)
    decisions = (
        *begin.notes,
        *loose,
        *(d.sentence for d in dropped),
        *stereo_pan_bases.base_sentences(found, scatter, corners.pan),
        *(() if bow is None else (bow.sentence,)),
        *_decisions(found, board),
    )
    progress(N_STAGES, N_STAGES)
    return _calibration(found, corners, begin, board, image_size, dropped, scatter, decisions, bow)


def stack_corners(pairs: Sequence[BoardPair], board: Board) -> CornerStack:
    """Lay the corners of all views end to end, sorted by pair, left before right."""
    views = [
        (i, side, view)
        for i, pair in enumerate(pairs)
        for side, view in enumerate((pair.left, pair.right))
        if view is not None
    ]
    corner = np.concatenate([v.corner for _, _, v in views])
    spread = np.concatenate([v.covariance for _, _, v in views])
    return CornerStack(
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
    corners: CornerStack,
    begin: BundleStart,
    board: Board,
    image_size: tuple[int, int],
    dropped: Sequence[stereo_model_selection.DroppedCoefficient],
    scatter: PanScatter | None,
    decisions: tuple[str, ...],
    bow: model_selection.BoardBow | None,
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
        covariance=_named_covariance(found, full, dropped),
    )
    residuals = collect_residuals(found, corners, frames)
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
        square_found=square_edges(found.state, corners, found.used, board),
        turning=begin.bases != (BASE_FIXED, BASE_FIXED),
    )


def _covariances(
    found: Estimate,
    board: Board,
    dropped: Sequence[stereo_model_selection.DroppedCoefficient],
    bow: model_selection.BoardBow | None,
) -> tuple[Array, Array]:
    """Of the rig's parameters (44, 44) and of the boards' poses (b, 6, 6)."""
    full = found.covariance
    if dropped:
        full = full + stereo_model_selection.held_covariance(
            dropped, held_response(found, tuple(d.name for d in dropped))
        )
    if bow is not None:  # fitted along, so not known exactly
        full = full + found.together * bow.response @ bow.covariance @ bow.response.T
    boards = board_covariance(found, full)
    if board.square_standard_uncertainty:  # all lengths grow with the squares, together
        share = board.square_standard_uncertainty / board.square
        scaled = share * length_parameters(found.state)
        full = full + np.outer(scaled, scaled)
        shift = share * found.state.boards[:, :3, 3]
        boards = boards.copy()
        boards[:, :3, :3] += shift[:, :, None] * shift[:, None, :]
    return full, boards


def _named_covariance(
    found: Estimate, full: Array, dropped: Sequence[stereo_model_selection.DroppedCoefficient]
) -> Covariance:
    """What moves at all, as rig.toml states it."""
    moves = np.linalg.norm(found.basis, axis=1) > TOL_HELD
    uncertain = {d.name for d in dropped if d.remaining}
    chosen = [i for i, n in enumerate(PARAMETER_NAMES) if moves[i] or n in uncertain]
    degrees = min(float(found.degrees_of_freedom), found.together_degrees)
    return state_covariance(
        [PARAMETER_NAMES[i] for i in chosen], full[np.ix_(chosen, chosen)], degrees
    )


def _with_reading(camera: Camera, base: str, readings: Array, scatter: PanScatter | None) -> Camera:
    """State the reading of a base, and how far it may be off where the base turned."""
    if base == BASE_FIXED:
        return replace(camera, pan=float(readings[0]))
    deviation = None if scatter is None else scatter.deviation
    return replace(camera, pan=float(np.median(readings)), pan_standard_uncertainty=deviation)


def _decisions(found: Estimate, board: Board) -> list[str]:
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
