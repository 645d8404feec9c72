"""Find postures that keep the constraints, clear legs between them, and a short tour of poses.

Model: a probabilistic roadmap (Kavraki et al., 1996). Nodes are postures that keep the constraints,
drawn over the whole range and then about known ones (STRAY_SIGMA); edges are straight legs to the
N_NEIGHBOURS nearest, checked every LEG_STEP. An edge's length is the turn of the slowest joint,
max_j |dq_j|. The largest connected set is kept. The tour through the chosen poses is the nearest
next, improved by reversing parts (2-opt).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

import robots
from verify.core.records import Array, Index
from verify.errors import InputError
from verify.planning.constraints import REASONS, REMEDIES, PostureConstraints

N_BATCH = 20_000  # postures drawn at a time
MAX_DRAWN = 400_000
MIN_POSTURES = 150  # postures from all over; the others are found about these
MAX_NODES = 500
N_NEIGHBOURS = 12
LEG_STEP = np.deg2rad(5.0)  # between the postures at which a leg is checked
STRAY_SIGMA = np.deg2rad(20.0)  # standard deviation about a known posture, each joint
MAX_WALKS = 40  # rounds of drawing about known postures
MAX_ROUNDS = 20  # of improvements by reversing parts of the tour


@dataclass(frozen=True, slots=True)
class Roadmap:
    """n connected postures, and the paths between them."""

    q: Array  # (n, j), rad
    time: Array  # (n, n), of the shortest path, in turns of the slowest joint, rad
    before: Index  # (n, n): the posture before the column's on the path from the row's
    tried: int  # postures drawn
    excluded: dict[str, int]  # of them, by what excludes them

    def path(self, start: int, end: int) -> list[int]:
        """The postures from one to another, the first left out."""
        path = [end]
        while (previous := int(self.before[start, path[-1]])) != start:
            path.append(previous)
        return path[::-1]


def build_roadmap(constraints: PostureConstraints, rng: np.random.Generator) -> Roadmap:
    """Draw postures that keep the constraints, and connect them by legs that do.

    Raises:
        InputError: no posture keeps them; says how many each constraint excludes.
    """
    q, tried, excluded = _draw_postures(constraints, rng)
    if not len(q):
        raise _no_posture_refusal(constraints, tried, excluded)
    q = _reject_singular(constraints, _draw_nearby(constraints, q, rng))
    if not len(q):
        excluded[REASONS[-1]] += 1
        raise _no_posture_refusal(constraints, tried, excluded)
    first = _largest_component(q, _legs(constraints, q), tried, excluded)
    q = _reject_singular(constraints, _draw_nearby(constraints, first.q, rng))
    return _largest_component(q, _legs(constraints, q), tried, excluded)


def _reject_singular(constraints: PostureConstraints, q: Array) -> Array:
    """Leave out postures near a singularity: the analysis takes no pair there into its means."""
    arm = constraints.setup.arm
    if arm.dof != 6 or not len(q):  # more joints are always coupled
        return q
    kept: Array = q[np.array([found is None for found in robots.couplings(arm, q)], dtype=bool)]
    return kept


def _draw_postures(
    constraints: PostureConstraints, rng: np.random.Generator
) -> tuple[Array, int, dict[str, int]]:
    lower, upper = constraints.limits
    found = np.zeros((0, len(lower)))
    counts = np.zeros(len(REASONS), dtype=np.int64)
    tried = 0
    while len(found) < MIN_POSTURES and tried < MAX_DRAWN:
        q = rng.uniform(lower, upper, (N_BATCH, len(lower)))
        reason = constraints.reason(q)
        counts += np.bincount(reason[reason >= 0], minlength=len(REASONS))
        found = np.concatenate([found, q[reason < 0]])
        tried += len(q)
    excluded = {name: int(n) for name, n in zip(REASONS, counts, strict=True)}
    return found[:MIN_POSTURES], tried, excluded


def _draw_nearby(constraints: PostureConstraints, q: Array, rng: np.random.Generator) -> Array:
    """Add postures about known ones: where few are in view, they are neighbours."""
    for _ in range(MAX_WALKS):
        if len(q) >= MAX_NODES:
            break
        near = q[rng.integers(len(q), size=MAX_NODES)]
        near = near + STRAY_SIGMA * rng.standard_normal(near.shape)
        q = np.concatenate([q, near[constraints.good(near)]])
    return q[:MAX_NODES]


def _legs(constraints: PostureConstraints, q: Array) -> Array:
    """Find clear legs (e, 2) between near postures."""
    count = min(N_NEIGHBOURS + 1, len(q))
    near = KDTree(q).query(q, count, p=np.inf)[1].reshape(len(q), count)
    ends = np.stack([np.repeat(np.arange(len(q)), count), near.reshape(-1)], axis=1)
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = ends[ends[:, 0] != ends[:, 1]]
    return np.asarray(ends[clear_legs(constraints, q[ends[:, 0]], q[ends[:, 1]])])


def clear_legs(constraints: PostureConstraints, start: Array, end: Array) -> Array:
    """Whether all constraints are kept along straight legs (e, j) to (e, j), (e,)."""
    spans = np.abs(end - start).max(axis=1, initial=0.0)
    steps = np.maximum(np.ceil(spans / LEG_STEP).astype(int) - 1, 0)
    leg = np.repeat(np.arange(len(start)), steps)
    place = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in steps.tolist()] or [np.zeros(0)])
    between = start[leg] + place[:, None] * (end - start)[leg]
    kept = np.ones(len(start), dtype=bool)
    kept[leg[~constraints.good(between, passing=True)]] = False
    return kept


def _largest_component(q: Array, legs: Array, tried: int, excluded: dict[str, int]) -> Roadmap:
    """Keep the largest set of postures that can be reached from each other."""
    n = len(q)
    length = np.abs(q[legs[:, 0]] - q[legs[:, 1]]).max(axis=1, initial=0.0)
    graph = csr_array((length, (legs[:, 0], legs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    kept = np.flatnonzero(label == np.argmax(np.bincount(label)))
    time, before = dijkstra(graph[kept][:, kept], directed=False, return_predecessors=True)
    return Roadmap(q[kept], time, before.astype(np.int64), tried, excluded)


def _no_posture_refusal(
    constraints: PostureConstraints, tried: int, excluded: dict[str, int]
) -> InputError:
    """Count what excludes the postures; the last constraint that does gives the remedy."""
    counts = {name: n for name, n in excluded.items() if n}
    excluded_by = ", ".join(f"{n:,} by {name}" for name, n in counts.items())
    arm = constraints.setup.arm
    return InputError(
        "plan",
        f"none of {tried:,} postures of {arm.name} can be used: excluded {excluded_by}",
        "poses are planned where both cameras see 3 LEDs and the arm is clear of everything",
        REMEDIES[list(counts)[-1]],
    )


@dataclass(frozen=True, slots=True)
class MotionStop:
    """One posture on the way."""

    q: Array  # (j,), rad
    pose: int | None  # which of the poses, from 0; None: only passed


def plan_tour(
    constraints: PostureConstraints, roadmap: Roadmap, chosen: list[int], *, back: bool
) -> list[MotionStop]:
    """Order the chosen postures and connect them, directly where the constraints allow.

    `back`: the same path back as well, so that every pose is approached from either side. The first
    pose stands first.
    """
    places = np.array(chosen, dtype=np.int64)
    q = roadmap.q[places]
    length = roadmap.time[np.ix_(places, places)].copy()
    direct = np.abs(q[:, None] - q).max(axis=2)
    one, other = np.triu_indices(len(q), 1)
    free = clear_legs(constraints, q[one], q[other])
    straight = np.zeros(length.shape, dtype=bool)
    straight[one[free], other[free]] = straight[other[free], one[free]] = True
    length[straight] = direct[straight]
    # a short open tour: the nearest next, then parts reversed while that shortens it
    tours = [_improve_tour(_nearest(length, k), length) for k in range(min(len(length), 5))]
    order = min(tours, key=lambda tour: _tour_length(tour, length))
    stops = [MotionStop(q[order[0]], 0)]
    for number, (a, b) in enumerate(pairwise(order), start=1):
        if not straight[a, b]:
            between = roadmap.q[roadmap.path(int(places[a]), int(places[b]))[:-1]]
            stops += [MotionStop(row, None) for row in _shortcut(constraints, q[a], between, q[b])]
        stops.append(MotionStop(q[b], number))
    return stops + stops[-2::-1] if back else stops


def _nearest(length: Array, start: int) -> Index:
    order, left = [start], set(range(len(length))) - {start}
    while left:
        order.append(min(left, key=lambda k: length[order[-1], k]))
        left.remove(order[-1])
    return np.array(order, dtype=np.int64)


def _improve_tour(order: Index, length: Array) -> Index:
    n = len(order)
    for _ in range(MAX_ROUNDS):
        before = _tour_length(order, length)
        for i in range(n - 1):
            for k in range(i + 1, n):
                turned = np.concatenate([order[:i], order[i : k + 1][::-1], order[k + 1 :]])
                if _tour_length(turned, length) < _tour_length(order, length) - 1e-9:
                    order = turned
        if _tour_length(order, length) > before - 1e-9:
            break
    return order


def _tour_length(order: Index, length: Array) -> float:
    return float(length[order[:-1], order[1:]].sum())


def _shortcut(
    constraints: PostureConstraints, start: Array, between: Array, end: Array
) -> list[Array]:
    """Leave out postures of a path where the leg past them is clear as well."""
    whole = [start, *between, end]
    kept, at = [], 0
    while at < len(whole) - 1:
        ahead = np.array(whole[at + 1 :])
        free = clear_legs(constraints, np.tile(whole[at], (len(ahead), 1)), ahead)
        free[0] = True  # a leg of the roadmap
        at += 1 + int(np.flatnonzero(free)[-1])
        kept.append(whole[at])
    return kept[:-1]
