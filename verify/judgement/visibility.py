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

    Source: Baarda's internal reliability; shares as INTERFACE.md defines them.
    """
    joints = model.joints.shape[1]
    nothing = np.full(joints, np.nan)
    if len(model.comparison) < FEWEST_PAIRS:
        return Visibility(nothing, nothing, nothing, nothing)
    seen = model.seen
    whole = np.linalg.norm(seen.joints, axis=0)
    before = _share(seen.fitted, seen.hidden, whole)
    since = _share(seen.clock, seen.joints, whole)
    left = np.linalg.norm(project_out(model.fitted, model.offsets, model.prior), axis=0)
    left = np.where(before > INVISIBLE, left, 0.0)
    detectable = np.divide(DETECTION, left, out=nothing.copy(), where=left > 0)
    return Visibility(before, since, detectable, _separable(model, before))


def _share(fitted: Array, columns: Array, whole: Array) -> Array:
    left = np.linalg.norm(project_out(fitted, columns), axis=0)
    share = np.divide(left, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return np.where(share < INVISIBLE, 0.0, share)


def _separable(model: Model, share: Array) -> Array:
    """The largest over rivals of what an offset must reach to be told from theirs."""
    joints = model.offsets.shape[1]
    separable = np.full(joints, np.nan)
    for j in range(joints):
        if not share[j] > 0:
            continue
        sizes = []
        for rival in range(joints):
            if rival != j:
                fitted = np.concatenate([model.fitted, model.offsets[:, [rival]]], axis=1)
                left = project_out(fitted, model.offsets[:, [j]], model.prior)
                sizes.append(float(np.linalg.norm(left)))
        smallest = min(sizes, default=0.0)
        if smallest > INVISIBLE * float(np.linalg.norm(model.offsets[:, j])):
            separable[j] = DETECTION / smallest
    return separable
