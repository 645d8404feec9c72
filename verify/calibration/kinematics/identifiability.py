"""Identifiability of parameters: which the data support, and with what the others are confounded.

With the whitened columns D (m, L) of the candidates, 1 mm or 1° a unit, nuisances N (m, p) taken
out:

    R' R = D' D - D' N (1 + N' N)⁻¹ N' D        information on the parameters p (L,)

In the order given, a parameter is supported while its column is not a combination of the chosen
ones and the smallest singular value of R over them stays `least` or more: at 1 every combination is
known better than 1 mm or 1°; at 0 gauges alone are held, and a prior what the data leave open.
"""

from dataclasses import dataclass

import numpy as np

from verify.calibration.kinematics.chain import Parameter
from verify.core.records import Array

TOL_REDUNDANT = 1e-6  # of a column: what rounding leaves of one that others make up
MIN_SINGULAR_VALUE = 1.0  # of R: every combination known better than 1 mm or 1°
MIN_CONFOUNDING = 0.1  # share of a column in another's: smaller ones are not named


@dataclass(frozen=True, slots=True)
class UnidentifiableParameter:
    """A parameter that is held, and why."""

    parameter: Parameter
    redundant: bool  # a gauge: no motion separates it from the others; else this one does not
    confounded_with: tuple[tuple[Parameter, float], ...]  # with the share of each, largest first
    uncertainty_if_free: float  # standard, m or rad; inf: a gauge


@dataclass(frozen=True, slots=True)
class Identifiability:
    """The parameters that can be identified, and those that cannot."""

    supported: tuple[Parameter, ...]
    held: tuple[UnidentifiableParameter, ...]
    rank: int  # of all candidates together, whatever the noise
    candidates: int


def information_root(design: Array, nuisance: Array) -> Array:
    """Find upper triangular R with R'R the information on L parameters, nuisances taken out.

    The design (m, L) is whitened and scaled, the nuisance (m, p) whitened, of unit prior variance;
    R has at most L rows.
    """
    p = nuisance.shape[1]
    if not p:
        return np.asarray(np.linalg.qr(design, mode="r"))
    stacked = np.block([[nuisance, design], [np.eye(p), np.zeros((p, design.shape[1]))]])
    return np.asarray(np.linalg.qr(stacked, mode="r"))[p:, p:]


def identifiability(
    candidates: tuple[Parameter, ...], information: Array, least: float = MIN_SINGULAR_VALUE
) -> Identifiability:
    """Choose the parameters that the data support, of L candidates, those to keep first.

    The information is `information_root` of their columns, scaled by tolerance; `least` is the
    smallest singular value of R over the supported ones.
    """
    chosen: list[int] = []
    held: list[tuple[int, bool]] = []
    for k in range(len(candidates)):
        column = information[:, k]
        left = _column_remainder(information[:, chosen], column)
        redundant = float(np.linalg.norm(left)) <= TOL_REDUNDANT * float(np.linalg.norm(column))
        smallest = np.linalg.svd(information[:, [*chosen, k]], compute_uv=False)[-1]
        if redundant or len(chosen) == len(information) or smallest < least:
            held.append((k, redundant))
        else:
            chosen.append(k)
    norm = np.linalg.norm(information, axis=0)
    scaled = information / np.where(norm > 0, norm, 1.0)
    rank = int(np.linalg.matrix_rank(scaled, tol=TOL_REDUNDANT))
    return Identifiability(
        supported=tuple(candidates[k] for k in chosen),
        held=tuple(
            unsupported(candidates, information, k, chosen, redundant=redundant)
            for k, redundant in held
        ),
        rank=rank,
        candidates=len(candidates),
    )


def _column_remainder(columns: Array, column: Array) -> Array:
    if not columns.shape[1]:
        return column
    basis = np.linalg.qr(columns)[0]
    left: Array = column - basis @ (basis.T @ column)
    return left - basis @ (basis.T @ left)


def unsupported(
    candidates: tuple[Parameter, ...],
    information: Array,
    k: int,
    chosen: list[int],
    *,
    redundant: bool = False,
) -> UnidentifiableParameter:
    """Say with which of the chosen candidates number k is confounded, and how sure it would be."""
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
    """The observability indexes of parameters by N poses, from their `information_root`.

    Its columns are whitened and scaled by tolerance (1 mm, 1°). With singular values σ1 ≥ … ≥ σL:
    O1 = (σ1 … σL)^(1/L) / √N (Borm and Menq 1991: volume of the uncertainty), O2 = σL / σ1 (Driels
    and Pathre 1990: inverse condition number), O3 = σL (Nahvi, Hollerbach and Hayward 1994: the
    worst known combination), O4 = σL² / σ1 (Nahvi and Hollerbach 1996: noise amplification), O5 = 1
    / Σ 1/σi (Sun and Hollerbach 2008).
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
