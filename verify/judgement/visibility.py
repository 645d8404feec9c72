"""What the session could have shown: visible share, detectable and separable error a joint."""

from dataclasses import dataclass

import numpy as np

from verify.judgement.model import Model
from verify.records import Array
from verify.regression import project_out

FEWEST_PAIRS = 10  # fewer say nothing of a session's shares
# False alarm 0.1 % (two-sided, 3.29) and power 80 % (0.84).
DETECTION = 4.13
INVISIBLE = 1e-3  # a share below this is what rounding leaves of nothing


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
    joints = model.joints.shape[1]
    nothing = np.full(joints, np.nan)
    if len(model.comparison) < FEWEST_PAIRS:
        return Visibility(nothing, nothing, nothing, nothing)
    seen = model.seen
    whole = np.linalg.norm(seen.joints, axis=0)
    before = _share(seen.fitted, seen.hidden, whole)
    since = _share(seen.clock, seen.joints, whole)
    remaining = project_out(model.fitted, model.offsets, model.prior)
    remaining[:, before == 0] = 0.0
    left = np.linalg.norm(remaining, axis=0)
    detectable = np.divide(DETECTION, left, out=nothing.copy(), where=left > 0)
    return Visibility(before, since, detectable, _separable(remaining))


def _share(fitted: Array, columns: Array, whole: Array) -> Array:
    left = np.linalg.norm(project_out(fitted, columns), axis=0)
    share = np.divide(left, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return np.where(share < INVISIBLE, 0.0, share)


def _separable(remaining: Array) -> Array:
    """The largest over rivals of what an offset must reach to be told from theirs, (j,).

    Args:
        remaining: (r, j), what everything fitted and stated leaves of each joint's column.
    """
    gram = remaining.T @ remaining
    joints = len(gram)
    separable = np.full(joints, np.nan)
    for j in range(joints):
        rivals = [k for k in range(joints) if k != j and gram[k, k] > 0]
        left = [gram[j, j] - gram[j, k] ** 2 / gram[k, k] for k in rivals]
        smallest = min(left, default=float(gram[j, j]))
        if smallest > INVISIBLE**2 * gram[j, j] > 0:
            separable[j] = DETECTION / np.sqrt(smallest)
    return separable
