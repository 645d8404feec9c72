"""A long session in fewer pairs: a diagnosis tries hundreds of columns, each as long as a session.

More pairs would tell it little: what explains less than a share of the misfit is listed in no case.
"""

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from verify.comparison import Comparison
from verify.judgement.model import Model, Shares
from verify.regression import Whitener

A_JOINT_EACH = ("rate_variance",)  # of a comparison: one number a joint, not a pair


def thinned(model: Model, chosen: NDArray[np.int64]) -> Model:
    """The model of some pairs alone.

    Args:
        model: n pairs.
        chosen: their places, increasing.
    """
    rows = np.isin(model.white.pair, chosen)
    factors = tuple(model.white.factors[i] for i in chosen)
    pair = np.repeat(np.arange(len(factors)), [len(f) for f in factors])
    return replace(
        model,
        comparison=_some(model.comparison, chosen),
        white=Whitener(factors, pair.astype(np.int64)),
        xi=model.xi[rows],
        joints=model.joints[rows],
        hidden=model.hidden[rows],
        fitted=model.fitted[rows],
        seen=Shares(*(getattr(model.seen, f.name)[rows] for f in fields(Shares))),
        prior=model.prior[rows],
        prior_columns=model.prior_columns[chosen],
    )


def _some(comparison: Comparison, chosen: NDArray[np.int64]) -> Comparison:
    changes: dict[str, Any] = {}
    for field in fields(Comparison):
        value = getattr(comparison, field.name)
        if isinstance(value, tuple):
            changes[field.name] = tuple(value[i] for i in chosen)
        elif field.name not in A_JOINT_EACH:
            changes[field.name] = value[chosen]
    return replace(comparison, **changes)
