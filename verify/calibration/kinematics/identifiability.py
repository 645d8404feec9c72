"""Which parameters the data support, and with what each of the others is confounded."""

from dataclasses import dataclass

import numpy as np

from verify.calibration.kinematics.chain import Parameter
from verify.core.records import Array

TOL_REDUNDANT = 1e-6  # of a column: what rounding leaves of one that others make up
MIN_SINGULAR_VALUE = 1.0  # smallest singular value: every combination known better than 1 mm or 1°
MIN_CONFOUNDING = (
    0.1  # of the column that a parameter is confounded with others: below, not worth a word
)


@dataclass(frozen=True, slots=True)
class UnidentifiableParameter:
    """A parameter that is held, and why."""

    parameter: Parameter
    redundant: bool  # no motion tells it from the others: a gauge; else this motion does not
    with_: tuple[tuple[Parameter, float], ...]  # share of each, largest first; tolerance units
    alone: float  # standard uncertainty it would have beside the others, m or rad; inf: a gauge


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What can be identified."""

    supported: tuple[Parameter, ...]
    held: tuple[UnidentifiableParameter, ...]
    rank: int  # of all candidates together, whatever the noise
    candidates: int


def information_root(design: Array, nuisance: Array) -> Array:
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


def identifiability(candidates: tuple[Parameter, ...], information: Array) -> Identifiability:
    """Choose parameters, in the order given, as long as the data tell each from those before.

    Args:
        candidates: L of them, those to keep first.
        information: `information_root` of their columns, scaled by tolerance.
    """
    chosen: list[int] = []
    held: list[tuple[int, bool]] = []
    for k in range(len(candidates)):
        column = information[:, k]
        left = _column_remainder(information[:, chosen], column)
        redundant = float(np.linalg.norm(left)) <= TOL_REDUNDANT * float(np.linalg.norm(column))
        smallest = np.linalg.svd(information[:, [*chosen, k]], compute_uv=False)[-1]
        if redundant or len(chosen) == len(information) or smallest < MIN_SINGULAR_VALUE:
            held.append((k, redundant))
        else:
            chosen.append(k)
    rank = int(np.linalg.matrix_rank(information / _column_norms(information), tol=TOL_REDUNDANT))
    return Identifiability(
        supported=tuple(candidates[k] for k in chosen),
        held=tuple(
            _unsupported(candidates, information, k, redundant, chosen) for k, redundant in held
        ),
        rank=rank,
        candidates=len(candidates),
    )


def _column_norms(columns: Array) -> Array:
    length: Array = np.linalg.norm(columns, axis=0)
    return np.where(length > 0, length, 1.0)


def _column_remainder(columns: Array, column: Array) -> Array:
    if not columns.shape[1]:
        return column
    basis = np.linalg.qr(columns)[0]
    left: Array = column - basis @ (basis.T @ column)
    return left - basis @ (basis.T @ left)


def _unsupported(
    candidates: tuple[Parameter, ...],
    information: Array,
    k: int,
    redundant: bool,
    chosen: list[int],
) -> UnidentifiableParameter:
    column = information[:, k]
    size = float(np.linalg.norm(column))
    mix = np.linalg.lstsq(information[:, chosen], column, rcond=None)[0]
    parts = np.abs(mix) * np.linalg.norm(information[:, chosen], axis=0)
    shares = parts / size if size else np.zeros(len(chosen))
    named = [
        (candidates[i], float(s))
        for i, s in zip(chosen, shares, strict=True)
        if s > MIN_CONFOUNDING
    ]
    left = float(np.linalg.norm(_column_remainder(information[:, chosen], column)))
    alone = float("inf") if redundant or not left else candidates[k].tolerance / left
    return UnidentifiableParameter(
        candidates[k], redundant, tuple(sorted(named, key=lambda pair: -pair[1])), alone
    )


def observability_indices(information: Array, poses: int) -> dict[str, float]:
    """The observability indexes of identified parameters.

    Args:
        information: `information_root` of their columns, whitened, scaled by tolerance (1 mm, 1°).
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
