"""What of the joints is known well, and what badly: errors trade against each other."""

from typing import Any

import numpy as np

from reports.blocks import Block, Table, row
from reports.formatting import finite, measured, quantity, word
from reports.series import Array, numbers

SMALL = 0.1  # of the largest weight: left out of a sum's name
FEWEST = 2  # joints


def known_well_and_badly(summary: dict[str, Any]) -> list[Block]:
    """Set sums that are known well beside their members and the sum that is known worst."""
    entries = summary.get("joints") or []
    u = np.array([_or_nan(joint.get("standard_uncertainty_deg")) for joint in entries])
    mean = np.array([_or_nan(joint.get("mean_error_deg")) for joint in entries])
    covariance = _covariance(summary.get("joint_error_correlation"), u)
    if covariance is None:
        return []
    names = [word(joint.get("joint")) for joint in entries]
    known = np.flatnonzero(np.isfinite(np.diag(covariance)))
    part = covariance[np.ix_(known, known)]
    if len(known) < FEWEST or not np.isfinite(part).all():
        return []
    values, vectors = np.linalg.eigh(part)
    rows = [
        row(word(c.get("label")), measured(c.get("mean_error_deg"), sums), "axes are parallel")
        for c in summary.get("combinations") or []
        if c.get("why") == "well_known"
        and (sums := finite(c.get("standard_uncertainty_deg"))) is not None
    ]
    members = {j for c in summary.get("combinations") or [] if c.get("why") == "well_known"
               for j in c.get("joints") or []}  # fmt: skip
    for place, name in enumerate(names):
        if entries[place].get("joint") in members and np.isfinite(u[place]):
            rows.append(row(f"q{name}", measured(mean[place], u[place]), "a member by itself"))
    for which, why in ((0, "known best of all sums"), (-1, "known worst of all sums")):
        weights = vectors[:, which] / vectors[np.argmax(np.abs(vectors[:, which])), which]
        label = _label(weights, [names[k] for k in known])
        # of weights whose largest is one, as a sum of joints has them
        size = float(np.sqrt(max(values[which], 0.0))) / float(np.abs(vectors[:, which]).max())
        rows.append(row(label, measured(weights @ mean[known], size), why))
    return [
        Table(
            "Sums of the joints' mean errors, those known well beside those known badly.",
            "lrl",
            ("Sum", "Mean error ± u [°]", "Why it is given"),
            tuple(rows),
            (_spread(values),),
        )
    ]


def _spread(values: Array) -> str:
    ratio = float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else None
    return (
        f"The worst known sum is {quantity(ratio, '')} times as uncertain as the best known one: "
        "single joints are to be read together with their correlation. Weights under a tenth are "
        "left out of a sum's name."
    )


def _or_nan(value: Any) -> float:
    known = finite(value)
    return float("nan") if known is None else known


def _covariance(rows: Any, u: Array) -> Array | None:
    lines = [numbers(line) for line in rows] if isinstance(rows, list) else []
    if not len(u) or len(lines) != len(u) or any(len(line) != len(u) for line in lines):
        return None
    covariance: Array = np.array(lines) * np.outer(u, u)
    return covariance


def _label(weights: Array, names: list[str]) -> str:
    terms = [
        f"{'+' if w > 0 else '−'}{'' if abs(abs(w) - 1) < 0.005 else f'{abs(w):.2f}·'}q{name}"
        for w, name in zip(weights, names, strict=True)
        if abs(w) > SMALL
    ]
    return "".join(terms).removeprefix("+")
