"""Which parameters the data support, and with what each of the others is confounded."""

from dataclasses import dataclass

import numpy as np

from verify.arm_identification.parameters import Parameter
from verify.records import Array

REDUNDANT = 1e-6  # of a column: what rounding leaves of one that others make up
SUPPORTED = 1.0  # smallest singular value: every combination known better than 1 mm or 1°
SHARE = 0.1  # of the column that a parameter is confounded with others: below, not worth a word


@dataclass(frozen=True, slots=True)
class Unsupported:
    """A parameter that is held, and why."""

    parameter: Parameter
    redundant: bool  # no motion tells it from the others: a gauge; else this motion does not
    with_: tuple[tuple[Parameter, float], ...]  # share of each, largest first; tolerance units
    alone: float  # standard uncertainty it would have beside the others, m or rad; inf: a gauge


@dataclass(frozen=True, slots=True)
class Support:
    """What can be identified."""

    supported: tuple[Parameter, ...]
    held: tuple[Unsupported, ...]
    rank: int  # of all candidates together, whatever the noise
    candidates: int


def triangle(design: Array, nuisance: Array) -> Array:
    """Whitened columns with the nuisances taken out: R with R'R the parameters' information.

    Args:
        design: (m, L), whitened and scaled.
        nuisance: (m, p), whitened, of unit prior variance.

    Returns:
        (at most L, L), upper triangular.
    """
    p = nuisance.shape[1]
    if not p:
        return np.asarray(np.linalg.qr(design, mode="r"))
    stacked = np.block([[nuisance, design], [np.eye(p), np.zeros((p, design.shape[1]))]])
    return np.asarray(np.linalg.qr(stacked, mode="r"))[p:, p:]


def support(candidates: tuple[Parameter, ...], information: Array) -> Support:
    """Choose parameters, in the order given, as long as the data tell each from those before.

    Args:
        candidates: L of them, those to keep first.
        information: `triangle` of their columns, scaled by tolerance.
    """
    chosen: list[int] = []
    held: list[tuple[int, bool]] = []
    for k in range(len(candidates)):
        column = information[:, k]
        left = _left_over(information[:, chosen], column)
        redundant = float(np.linalg.norm(left)) <= REDUNDANT * float(np.linalg.norm(column))
        smallest = np.linalg.svd(information[:, [*chosen, k]], compute_uv=False)[-1]
        if redundant or len(chosen) == len(information) or smallest < SUPPORTED:
            held.append((k, redundant))
        else:
            chosen.append(k)
    rank = int(np.linalg.matrix_rank(information / _length(information), tol=REDUNDANT))
    return Support(
        supported=tuple(candidates[k] for k in chosen),
        held=tuple(_held(candidates, information, k, redundant, chosen) for k, redundant in held),
        rank=rank,
        candidates=len(candidates),
    )


def _length(columns: Array) -> Array:
    length: Array = np.linalg.norm(columns, axis=0)
    return np.where(length > 0, length, 1.0)


def _left_over(columns: Array, column: Array) -> Array:
    if not columns.shape[1]:
        return column
    basis = np.linalg.qr(columns)[0]
    left: Array = column - basis @ (basis.T @ column)
    return left - basis @ (basis.T @ left)


def _held(
    candidates: tuple[Parameter, ...],
    information: Array,
    k: int,
    redundant: bool,
    chosen: list[int],
) -> Unsupported:
    column = information[:, k]
    size = float(np.linalg.norm(column))
    mix = np.linalg.lstsq(information[:, chosen], column, rcond=None)[0]
    parts = np.abs(mix) * np.linalg.norm(information[:, chosen], axis=0)
    shares = parts / size if size else np.zeros(len(chosen))
    named = [(candidates[i], float(s)) for i, s in zip(chosen, shares, strict=True) if s > SHARE]
    left = float(np.linalg.norm(_left_over(information[:, chosen], column)))
    alone = float("inf") if redundant or not left else candidates[k].tolerance / left
    return Unsupported(
        candidates[k], redundant, tuple(sorted(named, key=lambda pair: -pair[1])), alone
    )


def observability(information: Array, poses: int) -> dict[str, float]:
    """The observability indexes of identified parameters.

    Args:
        information: `triangle` of their columns, whitened, scaled by tolerance (1 mm, 1°).
        poses: N, how many poses they rest on.

    Returns:
        With singular values σ1 ≥ … ≥ σL: O1 = (σ1 … σL)^(1/L) / √N (Borm and Menq 1991: volume of
        the uncertainty), O2 = σL / σ1 (Driels and Pathre 1990: inverse condition number), O3 = σL
        (Nahvi, Hollerbach and Hayward 1994: the worst known combination), O4 = σL² / σ1 (Nahvi and
        Hollerbach 1996: noise amplification), O5 = 1 / Σ 1/σi (Sun and Hollerbach 2008).
    """
    size = np.linalg.svd(information, compute_uv=False)
    if not len(size):
        return {}
    return {
        "O1": float(np.exp(np.mean(np.log(size))) / np.sqrt(poses)),
        "O2": float(size[-1] / size[0]),
        "O3": float(size[-1]),
        "O4": float(size[-1] ** 2 / size[0]),
        "O5": float(1 / np.sum(1 / size)),
    }
