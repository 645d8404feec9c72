"""What the session could have shown: visible share, detectable and separable error a joint."""

from dataclasses import dataclass

import numpy as np

from verify.judgement.model import INVISIBLE, Model
from verify.records import Array
from verify.regression import left_over

FEWEST_PAIRS = 10  # fewer say nothing of a session's shares
# False alarm 0.1 % (two-sided, 3.29) and power 80 % (0.84).
DETECTION = 4.13


@dataclass(frozen=True, slots=True)
class Visibility:
    """A joint each; nan where the session determines nothing. Angles in rad."""

    fraction: Array  # (j,), of an offset that was there at registration
    fraction_since: Array  # (j,), of one that arose later
    detectable: Array  # (j,), smallest offset that would be noticed
    separable: Array  # (j,), smallest that would be told from an offset of any other joint


def visibility(model: Model) -> Visibility:
    """Project out what was fitted, one joint at fault at a time.

    Source: Baarda's internal reliability; shares as docs/results.md defines them.
    """
    seen = model.seen
    nothing = np.full(model.joints.shape[1], np.nan)
    whole = np.linalg.norm(seen.joints, axis=0)
    before = _share(seen.fitted, seen.hidden, whole)
    since = _share(seen.clock, seen.joints, whole)
    gram = left_over(model.fitted, model.offsets, model.prior)
    gram[before == 0] = gram[:, before == 0] = 0.0
    left = np.sqrt(np.diag(gram))
    detectable = np.divide(DETECTION, left, out=nothing.copy(), where=left > 0)
    few = len(model.comparison) < FEWEST_PAIRS
    return Visibility(
        fraction=nothing if few else before,
        fraction_since=nothing if few else since,
        detectable=detectable,
        separable=_separable(gram),
    )


def _share(fitted: Array, columns: Array, whole: Array) -> Array:
    left = np.sqrt(np.diag(left_over(fitted, columns)))
    share = np.divide(left, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return np.where(share < INVISIBLE, 0.0, np.minimum(share, 1.0))  # rounding leaves 1 + 2e-16


def _separable(gram: Array) -> Array:
    """The largest over rivals of what an offset must reach to be told from theirs, (j,).

    Args:
        gram: (j, j), products of what everything fitted and stated leaves of the joints' columns.
    """
    joints = len(gram)
    separable = np.full(joints, np.nan)
    for j in range(joints):
        rivals = [k for k in range(joints) if k != j and gram[k, k] > 0]
        left = [gram[j, j] - gram[j, k] ** 2 / gram[k, k] for k in rivals]
        smallest = min(left, default=float(gram[j, j]))
        if smallest > INVISIBLE**2 * gram[j, j] > 0:
            separable[j] = DETECTION / np.sqrt(smallest)
    return separable
