"""Sets of points that fit the marker's distances, and the poses that a search begins at.

Nodes ("this point is that LED") a and b agree if their points are as far apart as their LEDs:

    ||pa - pb| - |la - lb|| <= MAX_DEVIATION * sqrt(e' (Va + Vb) e + 2 play²),  e along pa - pb

Three nodes, every two of which agree, give a pose. A marker of many LEDs has thousands of pairs
and triples of nodes.
"""

import math

import numpy as np

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import cross, distance, dot, scale_to_one
from verify.core.records import Array
from verify.measurement.correspondence.kernels.fit import N_STATE, POSITION, Scene, begin_fit
from verify.measurement.correspondence.kernels.points import MAX_DEVIATION, Index, insert_cost

# height over longest side: of a more slender triangle, gathering about a line finds the third LED
MIN_HEIGHT_RATIO = 0.01


@compiled
def variance_along(covariance: Array, x: float, y: float, z: float) -> float:
    """Variance along a direction, of a covariance (3, 3)."""
    own = covariance[0, 0] * x * x + covariance[1, 1] * y * y + covariance[2, 2] * z * z
    shared = covariance[0, 1] * x * y + covariance[0, 2] * x * z + covariance[1, 2] * y * z
    return float(own + 2 * shared)


@compiled
def join_nodes(
    scene: Scene, points: tuple[Index, Array, Array], play: float
) -> tuple[Index, Index, Array]:
    """List the nodes, and how far every two are from the marker's distance, in deviations.

    `points`: spots (c, 2), places (c, 3) m, covariance (c, 3, 3) m²; `play`, m: how far an LED's
    light may be from where the marker has it. Gives point and LED of each node, (m,) both, and the
    upper half of (m, m); infinitely far are nodes that share a spot or an LED.
    """
    spot, rig, covariance = points
    allowed, leds = scene[6], scene[7]
    count, nodes = len(spot), 0
    point, led = np.empty(len(leds) * count, np.int64), np.empty(len(leds) * count, np.int64)
    for one in range(len(leds)):
        for i in range(count):
            if allowed[0, one, spot[i, 0]] and allowed[1, one, spot[i, 1]]:
                point[nodes], led[nodes] = i, one
                nodes += 1
    deviation = np.empty((nodes, nodes))
    apart, sigma = np.empty((count, count)), np.empty((count, count))
    apart[:], sigma[:] = math.inf, 1.0
    for i in range(count):
        for j in range(i):
            if spot[i, 0] == spot[j, 0] or spot[i, 1] == spot[j, 1]:
                continue
            far = distance(rig[i], rig[j])
            over = 1.0 / far if far > 0.0 else 1.0
            x, y, z = (
                (rig[i, 0] - rig[j, 0]) * over,
                (rig[i, 1] - rig[j, 1]) * over,
                (rig[i, 2] - rig[j, 2]) * over,
            )
            spread = variance_along(covariance[i], x, y, z) + variance_along(covariance[j], x, y, z)
            apart[i, j] = apart[j, i] = far
            sigma[i, j] = sigma[j, i] = math.sqrt(spread + 2 * play * play)
    wanted = np.empty((len(leds), len(leds)))
    for a in range(len(leds)):
        for b in range(len(leds)):
            wanted[a, b] = distance(leds[a], leds[b])
    for b in range(nodes):
        for a in range(nodes):
            deviation[a, b] = math.inf
            if a < b and led[a] != led[b]:
                off = abs(apart[point[a], point[b]] - wanted[led[a], led[b]])
                deviation[a, b] = off / sigma[point[a], point[b]]
    return point[:nodes], led[:nodes], deviation


@compiled
def list_triangles(deviation: Array, edges: Index, led: Index, leds: Array, most: int) -> Index:
    """List triples of nodes (t, 3) every two of which agree, best first; no slender triangles.

    `deviation` (m, m), of `join_nodes`; `edges` (e, 2), best first; `led` (m,), of each node;
    `leds` (n, 3), m, flange frame. At most `most` are listed, by the sum of squares of the three
    deviations.
    """
    count, costs, triples = np.int64(0), np.empty(most), np.empty((most, 3), np.int64)
    side, other, across = np.empty(3), np.empty(3), np.empty(3)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        for c in range(b + 1, len(deviation)):
            if not (deviation[a, c] <= MAX_DEVIATION and deviation[b, c] <= MAX_DEVIATION):
                continue
            for i in range(3):
                side[i] = leds[led[b], i] - leds[led[a], i]
                other[i] = leds[led[c], i] - leds[led[a], i]
            cross(side, other, across)
            longest = max(dot(side, side), dot(other, other))
            if not math.sqrt(dot(across, across)) > MIN_HEIGHT_RATIO * longest:
                continue
            cost = deviation[a, c] ** 2 + deviation[a, b] ** 2 + deviation[b, c] ** 2
            place = insert_cost(cost, costs, triples, count)
            if place >= 0:
                triples[place, 0], triples[place, 1], triples[place, 2] = a, b, c
                if count < len(costs):
                    count += 1
    return triples[:count]


@compiled
def triangle_axes(a: Array, b: Array, c: Array, axes: Array) -> None:
    """Fill in a triangle's axes, rows of (3, 3): along its first side, in its plane, across it."""
    for i in range(3):
        axes[0, i], axes[1, i] = b[i] - a[i], c[i] - a[i]
    cross(axes[0], axes[1], axes[2])
    scale_to_one(axes[0])
    scale_to_one(axes[2])
    cross(axes[2], axes[0], axes[1])


@compiled
def begin_poses(
    points: tuple[Index, Array],
    graph: tuple[Index, Index],
    nodes: Index,
    leds: Array,
    rotation: Array,
    sigmas: tuple[float, float, float],
) -> tuple[Array, Index]:
    """Begin a hypothesis at each set of nodes: `state` (h, 85), as `fit_all` has it, and spots.

    `points`: spots (c, 2) and places (c, 3) m; `graph`: point and LED of each node, (m,) both;
    `nodes` (h, 1), (h, 2) or (h, 3); `leds` (n, 3), m, flange frame; `rotation` (h, 3, 3) or (1, 3,
    3), of no use where there are three nodes; `sigmas` as in `begin_fit`. Spots (h, 2, n): -1 for
    none.
    """
    spots, rig = points
    point, led = graph
    corners = nodes.shape[1]
    rig_axes, led_axes = np.empty((3, 3)), np.empty((3, 3))
    where, which = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    state, spot = np.empty((len(nodes), N_STATE)), np.full((len(nodes), 2, len(leds)), -1)
    for h in range(len(nodes)):
        begin_fit(state[h], sigmas)
        for k in range(corners):
            where[k], which[k] = point[nodes[h, k]], led[nodes[h, k]]
            spot[h, 0, which[k]], spot[h, 1, which[k]] = spots[where[k], 0], spots[where[k], 1]
        if corners == 3:
            triangle_axes(rig[where[0]], rig[where[1]], rig[where[2]], rig_axes)
            triangle_axes(leds[which[0]], leds[which[1]], leds[which[2]], led_axes)
        for i in range(3):
            for j in range(3):
                state[h, 3 * i + j] = rotation[h % len(rotation), i, j] if corners < 3 else 0.0
                for k in range(3 if corners == 3 else 0):
                    state[h, 3 * i + j] += rig_axes[k, i] * led_axes[k, j]
        for i in range(3):
            state[h, POSITION + i] = 0.0
            for k in range(corners):
                arm = dot(state[h, 3 * i : 3 * i + 3], leds[which[k]])
                state[h, POSITION + i] += (rig[where[k], i] - arm) / corners
    return state, spot
