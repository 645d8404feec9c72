"""Which poses to visit: those that together tell most of what is asked, everything else held open.

D-optimal for the parameters asked for, beside what is registered and stated (D_s): greedy, then
exchanged one by one for better ones. Source: Fedorov, Theory of Optimal Experiments, 1972; for
calibration Borm and Menq, 1991 (their O1 is this determinant).
"""

from dataclasses import dataclass

import numpy as np

from verify.judgement.model import Model
from verify.planning.constraints import Rows
from verify.planning.kinds import geometry, kind
from verify.planning.wishes import Bench
from verify.records import Array

STILL = ("offsets", "gains", "eccentricity", "kinematics")  # kinds that the poses decide
WIDE = 10.0  # units (1°, 1 %, 1 mm): prior of what is asked for, so that a gauge does no harm
LOOSE = 1e-6  # of the largest: prior of what is fitted with it
ROUNDS = 3  # of exchanges


@dataclass(frozen=True, slots=True)
class Information:
    """Rows of n candidate poses, six each: of what is asked for, and of everything else."""

    asked: Array  # (n, 6, a), in units
    others: Array  # (n, 6, o): fitted or held
    prior: Array  # (a + o,), information that there is beforehand


def information(bench: Bench, model: Model, observe: tuple[str, ...], weight: float) -> Information:
    """Lay the judgement's model of single visits out pose by pose.

    Args:
        bench: for the arm's geometry.
        model: of one pair at each candidate pose.
        observe: kinds; of those that only the motion decides the offsets stand for.
        weight: pairs that will be taken about each pose.
    """
    names = [name for name in observe if name in STILL] or ["offsets"]
    columns = []
    for name in names:
        if name == "kinematics":
            columns.append(geometry(bench, model)[1])
        elif name != "offsets" or "kinematics" not in names:  # those hold the offsets
            one = kind(name, model)
            columns += [part * one.scale for part in one.columns]
    asked = np.concatenate(columns, axis=1)
    size = np.linalg.norm(model.fitted, axis=0)
    fitted = model.fitted / np.where(size > 0, size, 1.0)
    # what does not average out is no better known for many pairs about a pose
    rows = np.concatenate([asked, fitted, model.prior], axis=1) * np.sqrt(weight)
    laid = np.zeros((len(model.comparison), 6, rows.shape[1]))
    place = np.concatenate([np.arange(len(f)) for f in model.white.factors])
    laid[model.white.pair, place] = rows
    prior = np.concatenate(
        [
            np.full(asked.shape[1], WIDE**-2),
            np.full(fitted.shape[1], LOOSE),
            np.ones(model.prior.shape[1]),
        ]
    )
    return Information(laid[:, :, : asked.shape[1]], laid[:, :, asked.shape[1] :], prior)


def some(known: Information, poses: Rows) -> Information:
    """Some of the candidates."""
    return Information(known.asked[poses], known.others[poses], known.prior)


def worth(known: Information, chosen: list[int], times: float = 1.0) -> float:
    """Ln det of the information on what is asked for, everything else held open.

    Args:
        known: the candidates.
        chosen: which are visited.
        times: by how many times more pairs each is seen than the rows were weighted for.
    """
    a = known.asked.shape[2]
    rows = np.concatenate([known.asked[chosen], known.others[chosen]], axis=2)
    flat = rows.reshape(-1, rows.shape[2])
    whole = np.diag(known.prior) + times * flat.T @ flat
    found = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(whole[a:, a:])[1]
    return float(found)


def choose(known: Information, count: int) -> list[int]:
    """Choose so many poses; which ones, (count,)."""
    chosen: list[int] = []
    for _ in range(min(count, len(known.asked))):
        chosen.append(_best(known, chosen))
    for _ in range(ROUNDS):
        changed = False
        for place in range(len(chosen)):
            rest = chosen[:place] + chosen[place + 1 :]
            better = _best(known, rest, chosen[place])
            changed |= better != chosen[place]
            chosen[place] = better
        if not changed:
            break
    return chosen


def _best(known: Information, chosen: list[int], standing: int | None = None) -> int:
    """The pose that adds most to the determinant; on a tie the one that stands there now."""
    gain = _gain(known, chosen)
    gain[chosen] = -np.inf
    best = int(np.argmax(gain))
    return standing if standing is not None and gain[best] <= gain[standing] + 1e-9 else best


def _gain(known: Information, chosen: list[int]) -> Array:
    """What each pose adds to ln det of what is asked for, given everything else, (n,)."""
    every = np.concatenate([known.asked, known.others], axis=2)
    a = known.asked.shape[2]
    whole = _added(every, every[chosen], known.prior)
    alone = _added(known.others, known.others[chosen], known.prior[a:])
    return whole - alone


def _added(rows: Array, chosen: Array, prior: Array) -> Array:
    """Increase of ln det by six more rows, by the matrix determinant lemma, (n,)."""
    if not rows.shape[2]:
        return np.zeros(len(rows))
    flat = chosen.reshape(-1, rows.shape[2])
    inverse = np.linalg.inv(np.diag(prior) + flat.T @ flat)
    seen = rows @ inverse @ np.swapaxes(rows, 1, 2)
    return np.asarray(np.linalg.slogdet(np.eye(6) + seen)[1])
