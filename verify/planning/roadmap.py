"""Postures that may be planned with, and straight joint-space legs between them that may too."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

import robots
from verify.errors import InputError
from verify.planning.constraints import REASONS, Constraints, Rows
from verify.records import Array

BATCH = 20_000  # postures drawn at a time
MOST_DRAWN = 400_000
ENOUGH = 150  # postures from all over; the others are found about these
NODES = 500
NEIGHBOURS = 12
STEP = np.deg2rad(5.0)  # between the postures that a leg is looked at
STRAY = np.deg2rad(20.0)  # standard deviation about a known posture, each joint
WALKS = 40  # rounds of straying
ROOM = "Give another --near or a wider --within-deg."
REMEDIES = dict(
    zip(
        REASONS,
        (
            "Turn the camera bases or move the rig: pan_deg and [robot_base] in rig.toml.",
            "Move the rig to where the flange looks, or give a larger --view-angle-deg.",
            "Move the rig nearer, or the LEDs apart.",
            "Give a lower --floor-mm.",
            "Move the rig away from the arm.",
            ROOM,
            ROOM,
        ),
        strict=True,
    )
)


@dataclass(frozen=True, slots=True)
class Roadmap:
    """n connected postures, and the ways between them."""

    q: Array  # (n, j), rad
    time: Array  # (n, n), of the shortest way, in turns of the slowest joint, rad
    before: Rows  # (n, n): on the way from the row's posture, what stands before the column's
    tried: int  # postures drawn
    excluded: dict[str, int]  # of them, by what excludes them

    def way(self, start: int, end: int) -> list[int]:
        """The postures from one to another, the first left out."""
        way = [end]
        while (previous := int(self.before[start, way[-1]])) != start:
            way.append(previous)
        return way[::-1]


def roadmap(constraints: Constraints, rng: np.random.Generator) -> Roadmap:
    """Draw postures that keep the constraints, and join them by legs that do.

    Raises:
        InputError: no posture keeps them; says how many each constraint excludes.
    """
    q, tried, excluded = _drawn(constraints, rng)
    if not len(q):
        raise _nothing(constraints, tried, excluded)
    q = _uncoupled(constraints, _strayed(constraints, q, rng))
    if not len(q):
        excluded[REASONS[-1]] += 1
        raise _nothing(constraints, tried, excluded)
    first = _largest(q, _legs(constraints, q), tried, excluded)
    q = _uncoupled(constraints, _strayed(constraints, first.q, rng))
    return _largest(q, _legs(constraints, q), tried, excluded)


def _uncoupled(constraints: Constraints, q: Array) -> Array:
    """Leave out what the judgement would: it takes no pair near a singularity into its means."""
    arm = constraints.bench.arm
    if arm.dof != 6 or not len(q):  # more joints are always coupled
        return q
    kept: Array = q[np.array([found is None for found in robots.couplings(arm, q)], dtype=bool)]
    return kept


def _drawn(constraints: Constraints, rng: np.random.Generator) -> tuple[Array, int, dict[str, int]]:
    lower, upper = constraints.lower, constraints.upper
    found = np.zeros((0, len(lower)))
    counts = np.zeros(len(REASONS), dtype=np.int64)
    tried = 0
    while len(found) < ENOUGH and tried < MOST_DRAWN:
        q = rng.uniform(lower, upper, (BATCH, len(lower)))
        reason = constraints.reason(q)
        counts += np.bincount(reason[reason >= 0], minlength=len(REASONS))
        found = np.concatenate([found, q[reason < 0]])
        tried += len(q)
    excluded = {name: int(n) for name, n in zip(REASONS, counts, strict=True)}
    return found[:ENOUGH], tried, excluded


def _strayed(constraints: Constraints, q: Array, rng: np.random.Generator) -> Array:
    """Add postures about those that are known: where few are in view, they are neighbours."""
    for _ in range(WALKS):
        if len(q) >= NODES:
            break
        near = q[rng.integers(len(q), size=NODES)]
        near = near + STRAY * rng.standard_normal(near.shape)
        q = np.concatenate([q, near[constraints.good(near)]])
    return q[:NODES]


def _legs(constraints: Constraints, q: Array) -> Array:
    """Legs (e, 2) between near postures, along which everything is kept."""
    count = min(NEIGHBOURS + 1, len(q))
    near = KDTree(q).query(q, count, p=np.inf)[1].reshape(len(q), count)
    ends = np.stack([np.repeat(np.arange(len(q)), count), near.reshape(-1)], axis=1)
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = ends[ends[:, 0] != ends[:, 1]]
    kept: Array = ends[clear(constraints, q[ends[:, 0]], q[ends[:, 1]])]
    return kept


def clear(constraints: Constraints, start: Array, end: Array) -> Array:
    """Say along which straight legs (e, j) to (e, j) everything is kept, (e,)."""
    spans = np.abs(end - start).max(axis=1, initial=0.0)
    steps = np.maximum(np.ceil(spans / STEP).astype(int) - 1, 0)
    leg = np.repeat(np.arange(len(start)), steps)
    place = np.concatenate([np.arange(1, n + 1) / (n + 1) for n in steps.tolist()] or [np.zeros(0)])
    between = start[leg] + place[:, None] * (end - start)[leg]
    kept = np.ones(len(start), dtype=bool)
    kept[leg[~constraints.good(between, on_the_way=True)]] = False
    return kept


def _largest(q: Array, legs: Array, tried: int, excluded: dict[str, int]) -> Roadmap:
    """Keep the largest set of postures that can be reached from each other."""
    n = len(q)
    length = np.abs(q[legs[:, 0]] - q[legs[:, 1]]).max(axis=1, initial=0.0)
    graph = csr_array((length, (legs[:, 0], legs[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    kept = np.flatnonzero(label == np.argmax(np.bincount(label)))
    part = graph[kept][:, kept]
    time, before = dijkstra(part, directed=False, return_predecessors=True)
    return Roadmap(q[kept], time, before.astype(np.int64), tried, excluded)


def _nothing(constraints: Constraints, tried: int, excluded: dict[str, int]) -> InputError:
    """Say what excludes every posture; the last that does is what to mend."""
    counts = {name: n for name, n in excluded.items() if n}
    said = ", ".join(f"{n:,} by {name}" for name, n in counts.items())
    return InputError(
        "plan",
        f"none of {tried:,} postures of {constraints.bench.arm.name} can be used: excluded {said}",
        "poses are planned where both cameras see 3 LEDs and the arm is clear of everything",
        REMEDIES[list(counts)[-1]],
    )
