"""Assign spots to LEDs in both images at once.

A hypothesis is an assignment with its fitted pose. Model, twice the negative log evidence against
clutter:

    E = chi² + UNPAIRED_COST n_one - SPOT_REWARD n_spots + MERGED_COST n_merged
    E' = E + min(departure², JUMP_COST)       with a predicted pose

    symbol               meaning                                                        unit
    R, p                 pose of the flange in the rig, fitted                          1, m
    shift                of the right image, for exposures that are not simultaneous    px
    spot                 index of each LED's spot in either image, -1 for none          1
    n_one                LEDs with a spot in one image alone                            1
    n_spots, n_merged    spots explained, of these merged ones                          1

Candidates come from geometry: points where two rays nearly meet, at the marker's distances. What
geometry leaves open (a symmetric marker, two LEDs that could change places) is decided by colour,
then by continuity with the previous pair, then by the pose nearest to the encoders'. The encoders
choose among hypotheses; their value enters no result.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.core.fiducials import Marker
from verify.core.records import Array, Flags, Index, Spots, StereoPair
from verify.core.rig import Rig
from verify.measurement.correspondence.hypotheses import (
    Hypotheses,
    SeedGraph,
    build_graph,
    find_edges,
    find_points,
    seed_hypotheses,
)
from verify.measurement.correspondence.kernels import entries as kernel
from verify.measurement.correspondence.refinement import (
    chi2_bounds,
    conflicts,
    departure,
    follow_prediction,
    is_single_led,
    merge,
    refine,
    score,
)
from verify.measurement.correspondence.views import (
    SpotViews,
    fit_limits,
    led_sigma,
    light_of,
    model_variance,
    prepare_views,
    skew_variance,
    spot_arrays,
    stereo_optics,
)

MAX_SEEDS = 512  # an octahedron of six LEDs, the most symmetric marker, has 480 a mirror image
MAX_PAIRS = 256  # best distances first: bounds the work in a scene of lamps
MIN_ADVANTAGE = 9.0  # of twice the log evidence: odds of 90 to 1, on noise allowed for generously
MAX_DEPARTURE = 2.0  # standard deviations to how far a prediction may be off
JUMP_COST = 50.0  # what a pose far from the prediction costs: two LED images and a half
MAX_REFERENCE_DEPARTURE = 3.0  # departures beyond which a reference does not bear on a pose
MIN_MARGIN = 1.0  # by how many departures the nearest must be nearer than the next
MIN_TRACKED = 3  # LEDs: any two lamps could be two LEDs
ENCODERS_POSITION = 0.07  # m, how far a faulty arm and a clock not yet known may be believed to err
ENCODERS_ROTATION = 0.2  # rad, of the same; marker symmetries lie above 1 rad


def search_assignments(views: SpotViews, rig_R_flange: Array, *, single: bool) -> Hypotheses:
    """Find the assignments with the most LEDs: from three in both images, else two, else one.

    `rig_R_flange` (3, 3) fills the turns that one or two LEDs leave open. `single`: try one LED of
    several; of use only where a prediction places it.
    """
    points = find_points(views)
    graph = build_graph(views, points)
    for leds in (3, 2, 1) if single or len(views.leds) == 1 else (3, 2):
        nodes = _nodes(graph, views.leds, leds)
        found = refine(views, seed_hypotheses(views, points, graph, nodes, rig_R_flange))
        if len(found):
            break
    return found


def _nodes(graph: SeedGraph, leds: Array, count: int) -> Index:
    """List the sets of so many nodes to begin with, best first."""
    if count == 3:
        edges = find_edges(graph)
        return kernel.list_triangles(graph.deviation, edges, graph.led, leds, MAX_SEEDS)
    return find_edges(graph)[:MAX_PAIRS] if count == 2 else np.arange(len(graph.led))[:, None]


@dataclass(frozen=True, slots=True)
class PosePrediction:
    """Where the chain expects the flange, from the pairs before.

    How far it may be off is taken as two standard deviations; a jump beyond is still found.
    """

    rig_T_flange: Array  # (4, 4), at this pair's left instant
    position_uncertainty: float  # m, how far it may be off
    rotation_uncertainty: float  # rad
    choice: str = ""  # of the pair before, as `Correspondence.choice`

    @property
    def sigmas(self) -> tuple[float, float]:
        """Standard deviations, m and rad."""
        return (
            self.position_uncertainty / MAX_DEPARTURE,
            self.rotation_uncertainty / MAX_DEPARTURE,
        )


@dataclass(frozen=True, slots=True)
class Correspondence:
    """Which spot is which LED, and how that was settled."""

    left_led: Index  # (m,), index into marker.leds
    left_spot: Index  # (m,), index into the left spots
    right_led: Index  # (k,)
    right_spot: Index  # (k,)
    rig_T_flange: Array | None  # (4, 4), coarse; a turn the LEDs leave open is the reference's
    choice: str  # geometry, colour, continuity, encoders; "" where nothing was identified
    status: str  # measured, too_few_leds, ambiguous_leds

    @property
    def sides(self) -> tuple[tuple[Index, Index], tuple[Index, Index]]:
        """LEDs and spots of the left image, and of the right."""
        return (self.left_led, self.left_spot), (self.right_led, self.right_spot)


def assign_leds(
    spots: tuple[Spots, Spots],
    rig: Rig,
    pans: tuple[float, float],
    marker: Marker,
    *,
    prediction: PosePrediction | None = None,
    expected: Callable[[], Sequence[Array]] = tuple,
    motion_tolerance_px: float = 2.0,
) -> Correspondence:
    """Find which spot is which LED, of a marker of one to six in any arrangement.

    Spots of the left and the right image come brightest first, at pans, rad, as read. The
    prediction, from the previous pairs, settles what geometry and colour leave open, and finds LEDs
    where too few are seen for geometry alone. `expected` gives rig_T_flange (4, 4) from the
    encoders; the nearest settles what is still open, and nothing else; it is called only then, and
    where nothing is predicted. LEDs may have moved by `motion_tolerance_px` between the two
    exposures. Where several assignments explain the spots equally the result is empty,
    `ambiguous_leds`; where none does, `too_few_leds`. An LED seen by one camera only is listed for
    that one.
    """
    if len(spots[0]) == 0 or len(spots[1]) == 0:
        return _no_result("too_few_leds")
    views = prepare_views(spots, rig, pans, marker, motion_tolerance_px)
    found, lone = _find(views, prediction, expected)
    if len(found) == 0:
        return _no_result("too_few_leds")
    best, unique, rivals = _rank(views, found, prediction)
    if unique and lone and is_single_led(found)[best]:
        choice = "continuity"
    elif unique:
        choice = "colour" if _needs_colour(views, found, best) else "geometry"
    elif not rivals.any():
        choice = "continuity"
    else:
        choice = "encoders"
        open_ones = np.flatnonzero(rivals | (np.arange(len(found)) == best))
        nearest = _nearest(views, found.take(open_ones), expected())
        if nearest is None:
            return _no_result("ambiguous_leds")
        best = int(open_ones[nearest])
    return _build_result(found, best, choice)


@dataclass(frozen=True, slots=True)
class TrackedLeds:
    """All n LEDs in both pictures, as a prediction identifies them: the left picture's first."""

    correspondence: Correspondence
    centre: Array  # (2 n, 2), px
    covariance: Array  # (2 n, 2, 2), px²
    peak: Array  # (2 n,), DN
    taken: Array  # (2 n,), s, the instant of each
    depth: Array  # (2 n,), m, rough distance along the optical axis
    width: Array  # (2 n,), px, full width at half height


def track_leds(
    pair: StereoPair,
    spots: tuple[Spots, Spots],
    rig: Rig,
    marker: Marker,
    prediction: PosePrediction,
    *,
    likely: tuple[float, Array],
    motion_tolerance_px: float,
) -> TrackedLeds | None:
    """Follow a prediction without a search; None where a search might find another assignment.

    It cannot where the pair before had no rival, each LED has a spot in both pictures and each
    likely spot is one LED, and chi² is less than the advantage that another assignment, of chi² 0
    at best, would need over this one. `likely`: standard uncertainty beyond which a spot is none,
    px, and an LED's least peak in either picture, (2,) DN, nan where not known.
    """
    if prediction.choice not in ("geometry", "colour") or len(marker) < MIN_TRACKED:
        return None
    optics = stereo_optics(rig.left, rig.right, (pair.pan_left, pair.pan_right))
    (vague, (left, right)), skew = likely, motion_tolerance_px
    instants = (
        (pair.t_left, (pair.left.shape[0] - 1) / 2, rig.left.line_time),
        (pair.t_right, (pair.right.shape[0] - 1) / 2, rig.right.line_time),
    )
    found = kernel.track_leds(
        (
            (spot_arrays(spots[0]), spots[0].peak, spots[0].diameter, left, instants[0]),
            (spot_arrays(spots[1]), spots[1].peak, spots[1].diameter, right, instants[1]),
        ),
        optics.arrays,
        (vague**2, model_variance(rig), skew_variance(skew)),
        (marker.leds, light_of(marker.colours)),
        fit_limits(led_sigma(marker) * optics.mean_focal, skew),
        (prediction.rig_T_flange, *prediction.sigmas, skew),
        (chi2_bounds(len(marker)), MIN_ADVANTAGE),
    )
    if found is None:
        return None
    pose, (left_spot, right_spot), *arrays, rows = found
    led = np.arange(len(marker))
    result = Correspondence(led, left_spot, led, right_spot, pose, prediction.choice, "measured")
    return TrackedLeds(result, *arrays, *rows)


def _find(
    views: SpotViews, prediction: PosePrediction | None, expected: Callable[[], Sequence[Array]]
) -> tuple[Hypotheses, bool]:
    """Search the images, and follow the prediction where there is one.

    Says whether what it found may be a single LED.
    """
    references = [prediction.rig_T_flange] if prediction is not None else expected()
    rig_R_flange = references[0][:3, :3] if len(references) else np.eye(3)
    found = search_assignments(views, rig_R_flange, single=prediction is not None)
    if prediction is not None:
        near = _departures(views, found, prediction) <= MAX_REFERENCE_DEPARTURE
        there = found if np.count_nonzero(near) == len(near) else found.take(near)
        tracked = follow_prediction(views, there, prediction.rig_T_flange, *prediction.sigmas)
        found = merge(found, tracked)
    stray = is_single_led(found)
    if not np.count_nonzero(stray):
        return found, False
    if prediction is not None:
        stray &= _departures(views, found, prediction) > MAX_REFERENCE_DEPARTURE
    return found.take(~stray), True


def _rank(
    views: SpotViews, found: Hypotheses, prediction: PosePrediction | None
) -> tuple[int, bool, Flags]:
    """Find the best hypothesis, whether it has no rival, and which rivals are also near (h,)."""
    if len(found) == 1:
        return 0, True, np.zeros(1, dtype=np.bool_)
    evidence = score(views, found)
    informed = evidence.copy()
    if prediction is not None:
        off = _departures(views, found, prediction)
        informed += np.minimum(off**2, JUMP_COST)
    best = int(np.argmin(informed))
    rivals = conflicts(found, best) & (evidence < evidence[best] + MIN_ADVANTAGE)
    return best, not rivals.any(), rivals & (informed < informed[best] + MIN_ADVANTAGE)


def _departures(views: SpotViews, found: Hypotheses, prediction: PosePrediction) -> Array:
    """Departures of hypotheses (h,) from a prediction, in its standard deviations."""
    return departure(views, found, prediction.rig_T_flange, *prediction.sigmas)


def _nearest(views: SpotViews, found: Hypotheses, expected_poses: Sequence[Array]) -> int | None:
    """Choose the hypothesis nearest to an encoders' pose, if one is near and clearly nearest."""
    if len(expected_poses) == 0:
        return None
    scales = ENCODERS_POSITION, ENCODERS_ROTATION
    off = np.min([departure(views, found, pose, *scales) for pose in expected_poses], axis=0)
    best = int(np.argmin(off))
    others = np.delete(off, best)
    clear = off[best] <= MAX_REFERENCE_DEPARTURE and np.all(others >= off[best] + MIN_MARGIN)
    return best if clear else None


def _needs_colour(views: SpotViews, found: Hypotheses, best: int) -> bool:
    """Say whether the same search, colour-blind, would have left a rival to the one found."""
    if np.count_nonzero(views.allowed) == views.allowed.size:
        return False
    everything = np.repeat(np.isfinite(views.pixels[:, None, :, 0]), len(views.leds), axis=1)
    if np.array_equal(views.allowed, everything):
        return False
    chosen = found.take(np.array([best]))
    blind = replace(views, allowed=everything)
    pool = chosen.join(search_assignments(blind, chosen.rig_T_flange(0)[:3, :3], single=True))
    evidence = score(blind, pool)
    return bool(np.any(conflicts(pool, 0) & (evidence < evidence[0] + MIN_ADVANTAGE)))


def _build_result(found: Hypotheses, best: int, choice: str) -> Correspondence:
    left, right = found.spot[best]
    left_led, right_led = (left >= 0).nonzero()[0], (right >= 0).nonzero()[0]
    return Correspondence(
        left_led=left_led,
        left_spot=left[left_led],
        right_led=right_led,
        right_spot=right[right_led],
        rig_T_flange=found.rig_T_flange(best),
        choice=choice,
        status="measured",
    )


def _no_result(status: str) -> Correspondence:
    none = np.zeros(0, dtype=np.int64)
    return Correspondence(none, none, none, none, None, "", status)
