"""Every assignment of spots to LEDs that explains the images, found without knowing the past."""

import numpy as np

from verify.identification.hypotheses import (
    ALONE_COST,
    REWARD,
    Hypotheses,
    follow,
    polish,
    seed,
)
from verify.identification.kernel_points import Index
from verify.identification.seeds import Graph, find_edges, find_points, find_triangles, link
from verify.identification.views import Views
from verify.records import Array

MOST_PAIRS = 256  # best distances first: bounds the work in a scene of lamps


def search(views: Views, rig_R_flange: Array, *, single: bool) -> Hypotheses:
    """Find the assignments with the most LEDs: from three in both images, else two, else one.

    Args:
        views: the two images.
        rig_R_flange: (3, 3), what fills the turns that one or two LEDs leave open.
        single: try one LED of several; it says nothing unless the past says where it should be.
    """
    points = find_points(views)
    graph = link(views, points)
    for leds in (3, 2, 1) if single or len(views.leds) == 1 else (3, 2):
        nodes = _nodes(graph, views.leds, leds)
        found = polish(views, seed(views, points, graph, nodes, rig_R_flange))
        if len(found):
            break
    return found


def _nodes(graph: Graph, leds: Array, count: int) -> Index:
    """List the sets of so many nodes to begin with, best first."""
    if count == 3:
        return find_triangles(graph, leds)
    return find_edges(graph)[:MOST_PAIRS] if count == 2 else np.arange(len(graph.led))[:, None]


def track(
    views: Views, found: Hypotheses, rig_T_flange: Array, position: float, rotation: float
) -> Hypotheses:
    """Take the spots nearest to a predicted pose, alone and from what the search found.

    Args:
        views: the two images.
        found: what the search found there; LEDs that one camera alone sees are looked for anew.
        rig_T_flange: (4, 4), the prediction.
        position: m, its standard uncertainty.
        rotation: rad, likewise.
    """
    place = np.array([position] * 3 + [rotation] * 3)
    return follow(views, found, rig_T_flange, place, settled=_nothing_left(views, found))


def _nothing_left(views: Views, found: Hypotheses) -> bool:
    """Say whether there is one assignment, with a spot for every LED and none to spare.

    Its fit is so good that no LED less would explain the images better.
    """
    spots = np.count_nonzero(np.isfinite(views.pixels[..., 0]), axis=1)
    return (
        len(found) == 1
        and bool(np.all(found.spot >= 0))
        and bool(np.all(spots == len(views.leds)))
        and bool(found.chi2[0] < REWARD + ALONE_COST)
    )
