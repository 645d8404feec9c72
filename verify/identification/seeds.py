"""Where a search starts: spot pairs that may be one LED, and sets of them that fit the marker.

A pair of spots is a point in the rig if their rays nearly meet. Two points may be two LEDs if they
are as far apart as the marker says; three such points, every two of which agree, are a seed.
"""

from dataclasses import dataclass

import numpy as np

from verify.identification import kernel_points, kernel_seeds
from verify.identification.kernel_points import Index
from verify.identification.views import Views
from verify.records import Array

MOST_POINTS = 120  # best rays first; keeps a scene full of lamps on one line within bounds
MOST_EDGES = 3000  # best distances first, likewise
MOST_SEEDS = 512  # an octahedron of six LEDs, the most symmetric marker, has 480 a mirror image


@dataclass(frozen=True, slots=True)
class Points:
    """Pairs of spots whose rays nearly meet, and where."""

    spot: Index  # (c, 2), left and right spot
    rig: Array  # (c, 3), m
    covariance: Array  # (c, 3, 3), m²; a shift common to all changes distances by less


@dataclass(frozen=True, slots=True)
class Graph:
    """Nodes are "this point is that LED"; edges join those at the marker's distance."""

    point: Index  # (m,)
    led: Index  # (m,)
    deviation: Array  # (m, m), standard deviations of distance; inf where excluded


def find_points(views: Views) -> Points:
    """Pair left with right spots that lie on each other's epipolar line, within noise and skew."""
    spots = views.pixels.shape[1]
    spot, where = np.empty((MOST_POINTS, 2), dtype=np.int64), np.empty((spots, spots, 3))
    count = kernel_points.pair_spots(
        views.cameras,
        (views.pixels, views.covariance),
        views.allowed,
        views.leds,
        views.mean_focal,
        views.skew,
        where,
        np.empty(MOST_POINTS),
        spot,
    )
    spot, rig, covariance = spot[:count], np.empty((count, 3)), np.empty((count, 3, 3))
    kernel_points.locate(views.cameras, views.covariance, where, spot, rig, covariance)
    return Points(spot, rig, covariance)


def link(views: Views, points: Points) -> Graph:
    """Join points that may be LEDs at the marker's distances, within noise and skew."""
    point, led = np.empty((2, len(points.spot) * len(views.leds)), dtype=np.int64)
    count = kernel_seeds.list_nodes(points.spot, views.allowed, point, led)
    point, led, deviation = point[:count], led[:count], np.empty((count, count))
    places = points.spot, points.rig, points.covariance
    kernel_seeds.join_nodes(places, point, led, views.leds, views.led_play, deviation)
    return Graph(point, led, deviation)


def find_edges(graph: Graph) -> Index:
    """List pairs of nodes that agree, (e, 2), best first."""
    edges = np.empty((MOST_EDGES, 2), dtype=np.int64)
    return edges[: kernel_seeds.list_edges(graph.deviation, np.empty(MOST_EDGES), edges)]


def find_triangles(graph: Graph, leds: Array) -> Index:
    """List triples of nodes every two of which agree, (t, 3), best first; slender ones left out."""
    triples, costs = np.empty((MOST_SEEDS, 3), dtype=np.int64), np.empty(MOST_SEEDS)
    edges = find_edges(graph)
    return triples[
        : kernel_seeds.list_triangles(graph.deviation, edges, graph.led, leds, costs, triples)
    ]
