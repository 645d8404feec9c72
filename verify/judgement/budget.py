"""Each joint's mean error taken apart: how much of its uncertainty comes from which source."""

import numpy as np
import pandas as pd

from verify.judgement.means import JointErrors, Means
from verify.judgement.model import Model, pan_columns
from verify.records import Array
from verify.systematics import Systematics
from verify.track import Track

COLUMNS = ["joint", "source", "kind", "standard_uncertainty_deg"]


def budget(
    model: Model,
    errors: JointErrors,
    means: Means,
    inverse: Array,
    systematics: Systematics,
    track: Track,
    clock_uncertainty: float | None,
) -> pd.DataFrame:
    """One row a joint and source: its share of the mean error's standard uncertainty, degrees.

    Args:
        model: the session's linear model.
        errors: joint errors a pair.
        means: what the sources must add up to.
        inverse: (n, j, 6), d joints / d pose.
        systematics: stated parameters.
        track: measured poses (pan readings).
        clock_uncertainty: s, of the clock offset, given or estimated; None where taken as exact.
    """
    rows: list[tuple[int, str, str, float]] = []
    known = ~np.isnan(errors.error)
    weight = known / np.maximum(known.sum(axis=0), 1)
    joints = weight.shape[1]
    parts: list[tuple[str, str, Array]] = [("pixels, alignment, readings", "random", means.random)]
    moved = np.einsum(
        "ni,nij,njp->ip",
        weight,
        inverse,
        model.comparison.systematic[:, :, : len(systematics.names)],
    )
    for source in dict.fromkeys(systematics.sources):
        mine = np.array([s == source for s in systematics.sources])
        block = moved[:, mine] @ systematics.covariance[np.ix_(mine, mine)] @ moved[:, mine].T
        parts.append((source, "systematic", np.sqrt(np.maximum(np.diag(block), 0.0))))
    pan = np.concatenate(
        [pan_columns(model.comparison, track, systematics, side) for side in (0, 1)], axis=2
    )
    if pan.shape[2]:
        share = np.einsum("ni,nij,njp->ip", weight, inverse, pan)
        parts.append(("pan angle", "systematic", np.linalg.norm(share, axis=1)))
    if clock_uncertainty:
        drift = np.abs((model.comparison.rate * weight).sum(axis=0)) * clock_uncertainty
        parts.append(("clock", "systematic", drift))
    for source, kind, u in parts:
        rows += [(j + 1, source, kind, float(np.rad2deg(u[j]))) for j in range(joints)]
    return pd.DataFrame(rows, columns=COLUMNS)
