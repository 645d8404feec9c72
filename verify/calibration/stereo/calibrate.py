"""Calibrate the stereo rig on its turning bases from corners in pairs of images.

The stages: choose the usable pairs and start values, a robust adjustment, the board's bow, the
bases' axes and the readings' scatter, the final adjustment; what it leaves open is refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.calibration.stereo import bundle, estimate, pan_bases, refusals, start
from verify.calibration.stereo import parameters as par
from verify.calibration.stereo.gauge import BASE_FIXED, AdjustmentModel, fixed_names
from verify.calibration.stereo.prior import open_coefficients, prior_rows
from verify.calibration.stereo.records import Calibration, Residuals, state_covariance
from verify.calibration.stereo.scatter import ErrorScatter
from verify.core.fiducials import Board, BoardPair, BoardView
from verify.core.records import SIDES, Array, Index, Progress, no_progress
from verify.core.rig import Camera, Covariance, Rig
from verify.core.statistics import chi2_isf

MIN_CORNERS = 6  # of a view: twelve coordinates for the six of a pose
MIN_EXTENT = 0.5  # squares, second extent of a view's corners: on one line they fix no pose
N_STAGES = 5
MAX_HAND_VARIANCE = 2.0  # of what is left without it: beyond it motion and bend are adjusted
P_FALSE_BOW = 1e-3  # that a flat board seems bowed
TOL_HELD = 1e-8  # of a unit step: a parameter that the free directions move by less is held


@dataclass(frozen=True, slots=True)
class BundleStart:
    """What the adjustment begins with."""

    pairs: tuple[BoardPair, ...]  # the usable pairs with their usable views
    state: par.BundleState
    bases: tuple[str, str]
    notes: tuple[str, ...]  # what was left out and why


@dataclass(frozen=True, slots=True)
class _AdjustedBundle:
    """The final estimate, and what was chosen on the way."""

    found: estimate.Estimate
    held: estimate.Estimate | None  # with boards that moved or bent in the hand; None: none did
    corners: par.CornerStack
    scatter: ErrorScatter | None  # of pan readings; None: no base turned


def calibrate(
    pairs: Sequence[BoardPair],
    board: Board,
    image_size: tuple[int, int],
    *,
    progress: Progress = no_progress,
) -> Calibration:
    """Find both cameras, their relation and how their bases turn.

    All parameters are adjusted at once to the corners of all pairs, weighted by their stated
    covariance. Bases that turned between pairs are found with axis, centre, zero and mount; as far
    as the readings' range leaves these open, usual bases are assumed (see `prior`). The others are
    fixed by convention (see `gauge`). The image size is width and height, px; `progress` is called
    with stages done and stages in all.

    Raises:
        InputError: no board found, fewer than three pairs, a board turned by 180° in one camera,
            left and right swapped, pairs that do not agree, or boards that leave a focal length or
            principal point open. Its place is "left", "right" or "pairs".
    """
    progress(0, N_STAGES)
    begin = gather_pairs(pairs, board, image_size)
    progress(1, N_STAGES)
    adjusted = _adjust(begin, board, image_size, progress)
    found, corners = adjusted.found, adjusted.corners
    full, boards = _covariances(found, board)
    sides = zip(found.state.cameras, found.model.bases, corners.pan.T, strict=True)
    left, right = (_with_reading(*side, adjusted.scatter) for side in sides)
    frames = np.array([p.frame for p in begin.pairs])
    refusals.refuse_changed(motion := _seen_errors(adjusted, par.MOTION), frames.tolist())
    progress(N_STAGES, N_STAGES)
    return Calibration(
        rig=Rig(
            image_size=image_size,
            left=left,
            right=right,
            rig_T_base=np.full((4, 4), np.nan),
            base_source="",
            covariance=_named_covariance(found, full),
        ),
        board=board,
        frames=frames,
        rig_T_board=found.state.boards,
        board_covariance=boards,
        residuals=Residuals(
            camera=corners.camera,
            frame=frames[corners.board],
            corner=corners.corner,
            observed=corners.observed,
            residual=corners.observed - bundle.predict(found.state, corners),
            uncertainty=corners.uncertainty * found.noise,
            used=found.used,
        ),
        noise=found.noise,
        degrees_of_freedom=found.degrees_of_freedom,
        fixed=fixed_names(found.model),
        decisions=(*begin.notes, *_decisions(adjusted, board, frames)),
        square_found=estimate.square_edges(found, corners, board),
        turning=begin.bases != (BASE_FIXED, BASE_FIXED),
        motion=motion,
    )


def gather_pairs(
    pairs: Sequence[BoardPair], board: Board, image_size: tuple[int, int]
) -> BundleStart:
    """Choose the usable pairs and find start values.

    Raises:
        InputError: too few pairs, a board turned by 180° in one camera, left and right swapped, or
            pairs that do not agree.
    """
    views = [(usable_view(p.left, board), usable_view(p.right, board)) for p in pairs]
    usable = [replace(p, left=v[0], right=v[1]) for p, v in zip(pairs, views, strict=True)]
    usable, notes = _drop_foreign(usable, board)
    usable, copies = drop_copies(usable)
    refusals.refuse_unseen(usable, " ".join(copies))
    notes += copies
    lenses = [start.start_lens(_views(usable, side), board, image_size) for side in (0, 1)]
    readings = np.array([[p.pan_left, p.pan_right] for p in usable])
    kinds = pan_bases.base_kinds(readings)
    relation = start.relate_cameras(lenses[0].poses, lenses[1].poses, board, readings, kinds)
    frames = [p.frame for p in usable]
    refusals.refuse_half_turned(relation, [lens.poses for lens in lenses], frames)
    both = sum(p.left is not None and p.right is not None for p in usable)
    refusals.refuse_inconsistent(
        relation, both, kinds != (BASE_FIXED, BASE_FIXED), four_fold=board.four_fold
    )
    refusals.refuse_swapped(relation)
    refusals.refuse_one_place([lens.poses for lens in lenses])
    outliers = sorted(set(relation.outliers) - set(relation.quarter_turned))
    if outliers:
        named = refusals.list_pairs([frames[i] for i in outliers])
        notes.append(
            f"{named} left out: the cameras are placed differently there than in the others."
        )
    if relation.quarter_turned:
        named = refusals.list_pairs([frames[i] for i in relation.quarter_turned])
        notes.append(
            f"{named} left out: one camera numbers the board's corners a quarter turn from the "
            "other, which a square board of even counts cannot tell; hold it upright."
        )
    chosen = [
        i
        for i, pair in enumerate(usable)
        if i not in relation.outliers and not (pair.left is None and pair.right is None)
    ]
    kept = tuple(usable[i] for i in chosen)
    refusals.refuse_unseen(kept)
    state = start.start_state(lenses, relation, readings, chosen, kinds)
    return BundleStart(kept, state, kinds, tuple(notes))


def _views(pairs: Sequence[BoardPair], side: int) -> dict[int, BoardView]:
    return {i: v for i, p in enumerate(pairs) if (v := (p.left, p.right)[side]) is not None}


def _drop_foreign(pairs: list[BoardPair], board: Board) -> tuple[list[BoardPair], list[str]]:
    """Drop the views in which something else was taken for the board; notes name them."""
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


def drop_copies(pairs: Sequence[BoardPair]) -> tuple[list[BoardPair], list[str]]:
    """Drop pairs whose two pictures are those of an earlier pair: they show nothing more."""
    first: dict[tuple[bytes, ...], int] = {}
    kept, copies = [], []
    for pair in pairs:
        views = [v for v in (pair.left, pair.right) if v is not None]
        key = tuple(b for v in views for b in (v.corner.tobytes(), v.centre.tobytes()))
        if len(views) == len(SIDES) and first.setdefault(key, pair.frame) != pair.frame:
            copies.append(pair.frame)
        else:
            kept.append(pair)
    if not copies:
        return kept, []
    named = refusals.list_pairs(copies)
    return kept, [f"{named} left out: the same pictures as in an earlier pair."]


def usable_view(view: BoardView | None, board: Board) -> BoardView | None:
    """Accept a view whose corners fix a board's pose; None: too few of them, or all on one line."""
    if view is None or len(view) < MIN_CORNERS:
        return None
    points = board.points[view.corner, :2]
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return view if extent[1] > MIN_EXTENT * board.square else None


def stack_corners(pairs: Sequence[BoardPair], board: Board) -> par.CornerStack:
    """Stack the corners of all views, sorted by pair, left before right."""
    views = [
        (i, side, view)
        for i, pair in enumerate(pairs)
        for side, view in enumerate((pair.left, pair.right))
        if view is not None
    ]
    corner = np.concatenate([v.corner for _, _, v in views])
    spread = np.concatenate([v.covariance for _, _, v in views])
    xy = board.points[:, :2] - board.points[:, :2].mean(axis=0)
    x, y = (xy / (np.ptp(xy, axis=0).max() / 2)).T
    return par.CornerStack(
        camera=np.concatenate([np.full(len(v), side) for _, side, v in views]),
        board=np.concatenate([np.full(len(v), i) for i, _, v in views]),
        corner=corner,
        point=board.points[corner],
        modes=np.stack([x * x, x * y, y * y], axis=1)[corner],
        observed=np.concatenate([v.centre for _, _, v in views]),
        root=np.linalg.inv(np.linalg.cholesky(spread)),
        uncertainty=np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2),
        pan=np.array([[p.pan_left, p.pan_right] for p in pairs]),
    )


def _adjust(
    begin: BundleStart, board: Board, image_size: tuple[int, int], progress: Progress
) -> _AdjustedBundle:
    """Adjust in stages, and refuse what the last one leaves open."""
    corners = stack_corners(begin.pairs, board)

    def model_at(state: par.BundleState) -> AdjustmentModel:
        noise = float(np.sqrt(estimate.robust_scale(bundle.squared_distances(state, corners))))
        precision = pan_bases.start_precision(begin.bases, noise)
        prior = prior_rows(state, begin.bases, image_size, noise**2)
        return AdjustmentModel(begin.bases, precision, prior)

    starts = begin.state, *start.other_senses(begin.state, corners.pan, begin.bases)
    states = [estimate.adjust_cauchy(one, corners, model_at(one)) for one in starts]
    progress(2, N_STAGES)
    tried = [estimate.adjust_robust(one, corners, model_at(one)) for one in states]
    # of axes that may point either way, those that leave least, of corners and of pan readings
    shared = np.all([one.used for one in tried], axis=0).astype(float)
    found = min(tried, key=lambda one: bundle.cost(one.state, corners, one.model, shared))
    progress(3, N_STAGES)
    bowed = estimate.adjust_robust(found.state, corners, replace(found.model, bowed=True))
    found = bowed if _bow_shows(bowed) else found
    found, scatter = pan_bases.settle_bases(found, corners, image_size)
    progress(4, N_STAGES)
    prior = prior_rows(found.state, found.model.bases, image_size, found.variance)
    found = estimate.adjust_robust(found.state, corners, replace(found.model, prior=prior))
    held = pan_bases.boards_in_hand(found, corners, image_size)
    if held is not None:
        if found.noise**2 > MAX_HAND_VARIANCE * held.noise**2:
            found = held = estimate.adjust_robust(held.state, corners, held.model)
            if found.model.bowed and not _bow_shows(found):  # what hands do passed for a bow
                flat = replace(found.state, bow=np.zeros_like(found.state.bow))
                model = replace(found.model, bowed=False)
                found = held = estimate.adjust_robust(flat, corners, model)
        else:
            found = pan_bases.with_doubt(found, held)
    refusals.refuse_undetermined(found)
    return _AdjustedBundle(found, held, corners, scatter)


def _bow_shows(found: estimate.Estimate) -> bool:
    """Test the bow against what a flat board shows by chance."""
    own, height = found.covariance[par.BOW, par.BOW] / found.design_effect, found.state.bow
    shown = height @ np.linalg.solve(own, height) > chi2_isf(P_FALSE_BOW, len(height))
    return bool(shown)


def _seen_errors(adjusted: _AdjustedBundle, own: slice) -> Array | None:
    """Errors of all pairs (b, 3), m, that the pictures show; None where they show none."""
    held = adjusted.held
    shown = held is not None and np.isfinite(held.model.precision[own]).any()
    return held.state.errors[:, own] if held is not None and shown else None


def _covariances(found: estimate.Estimate, board: Board) -> tuple[Array, Array]:
    """Covariance of the shared parameters (47, 47) and of the boards' poses (b, 6, 6)."""
    full = found.covariance
    boards = estimate.board_covariance(found, full)
    if board.square_standard_uncertainty:  # all lengths scale with the squares, together
        share = board.square_standard_uncertainty / board.square
        scaled = share * par.length_parameters(found.state)
        full = full + np.outer(scaled, scaled)
        shift = share * found.state.boards[:, :3, 3]
        boards[:, :3, :3] += shift[:, :, None] * shift[:, None, :]
    return full, boards


def _named_covariance(found: estimate.Estimate, full: Array) -> Covariance:
    """State the covariance of the parameters that are not held exactly, as rig.toml does."""
    chosen = np.flatnonzero(
        np.linalg.norm(found.basis[: len(par.PARAMETER_NAMES)], axis=1) > TOL_HELD
    )
    degrees = min(float(found.degrees_of_freedom), found.design_effect_degrees)
    return state_covariance(
        [par.PARAMETER_NAMES[i] for i in chosen], full[np.ix_(chosen, chosen)], degrees
    )


def _with_reading(
    camera: Camera, base: str, readings: Array, scatter: ErrorScatter | None
) -> Camera:
    """State the reading of a base, and its standard uncertainty where the base turned."""
    if base == BASE_FIXED:
        return replace(camera, pan=float(readings[0]))
    deviation = None if scatter is None else scatter.deviation
    return replace(camera, pan=float(np.median(readings)), pan_standard_uncertainty=deviation)


def _decisions(adjusted: _AdjustedBundle, board: Board, frames: Index) -> Iterator[str]:
    """Describe what was chosen of bases, lens and board, and what was refused."""
    found = adjusted.found
    yield from open_coefficients(found)
    yield from pan_bases.base_sentences(found, adjusted.scatter, adjusted.corners.pan, frames)
    if (moved := _seen_errors(adjusted, par.MOTION)) is not None:
        motion = 1e3 * np.linalg.norm(moved, axis=1)
        yield (
            f"Left and right pictures were not taken together: between them the board moved by "
            f"{np.median(motion):.2g} mm in half of the pairs, up to {motion.max():.2g} mm. The "
            "uncertainties allow for it; better, let the board stand still or expose both at once. "
            "A camera that was touched, or a lens that was turned, between two pairs looks alike."
        )
    if (bent := _seen_errors(adjusted, par.BEND)) is not None:
        bend = 1e3 * np.abs(bent - bent.mean(axis=0)).max(axis=1)
        yield (
            f"the board bends from pair to pair: by {np.median(bend):.2g} mm between its middle "
            f"and its rim in half of the pairs, up to {bend.max():.2g} mm. The uncertainties allow "
            "for it; a stiff board is better."
        )
    if found.model.bowed:
        yield (
            f"the board is not flat: it bows by {1e3 * np.abs(found.state.bow).max():.2g} mm "
            "between its middle and its rim, which was fitted along; a flat, stiff board is better."
        )
    refused = int(np.sum(~found.used))
    if refused:
        yield (
            f"{refused} of {len(found.used)} corners rejected, as the others of their views "
            "contradict them."
        )
    if found.design_effect > 1:
        yield (
            "errors of a pair's corners are correlated (a board that bends in the hand, blur): "
            f"every standard uncertainty is {np.sqrt(found.design_effect):.2f} times the one that "
            "single residuals give."
        )
    if board.square_standard_uncertainty is None:
        yield (
            "The square's size carries no uncertainty: it is taken as exact, and with it every "
            "length."
        )
