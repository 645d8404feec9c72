"""One fault that might be, and how its figures are told."""

from dataclasses import dataclass

import numpy as np

from verify.records import Array

Name = tuple[str, int | None, str | None]
# beyond this, first order says nothing, and a column is what rounding leaves; m, rad, ratio
LARGEST = {"deg": np.deg2rad(20.0), "mm": 0.05, "ratio": 0.3}
# units of faults as they are told, in a SI unit
SCALES = {
    "deg": 180 / np.pi,
    "deg/m": 180 / np.pi,
    "deg/h": 3600 * 180 / np.pi,
    "mm": 1e3,
    "s": 1.0,
    "ppm": 1e6,
    "ratio": 1.0,
    "": 1.0,  # of what no single figure tells
}


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that might be: of one joint (1-based), or a common one (None)."""

    kind: str
    joint: int | None
    unit: str  # of its value in summary.json
    columns: Array  # (r, p), whitened, what a SI unit of each of its p coefficients does
    parameter: str | None = None  # of a link: a2, d4, alpha1, beta3
    per_turn: int | None = None  # of an eccentricity

    @property
    def name(self) -> Name:
        """What a diagnosis says of it; waves of another number a turn have the same name."""
        return self.kind, self.joint, self.parameter

    @property
    def largest(self) -> float:
        """Largest value that may be told, SI; infinite where there is no such bound."""
        return float(LARGEST.get(self.unit, np.inf))

    @property
    def freedom(self) -> int:
        """Number of its coefficients."""
        return int(self.columns.shape[1])


def told(fault: Fault, values: Array, covariance: Array) -> tuple[float, float, dict[str, float]]:
    """A fault's size, its standard uncertainty, and what else there is to say of it.

    Args:
        fault: with p coefficients.
        values: (p,), SI.
        covariance: (p, p).

    Returns:
        Value and standard uncertainty, SI: of several coefficients the length (of a displacement
        its shift alone; nan of what no single figure tells); and, rad: the phase of an
        eccentricity, the turn of a displacement.
    """
    if not fault.unit:
        return float("nan"), float("nan"), {}
    if fault.freedom == 1:
        return float(values[0]), float(np.sqrt(covariance[0, 0])), {}
    if fault.kind == "eccentricity":
        size, u = _length(values, covariance)
        waves = fault.per_turn or 1
        return size, u, {"phase": float(np.arctan2(values[1], values[0]) / waves)}
    shift, u = _length(values[:3], covariance[:3, :3])
    return shift, u, {"turn": float(np.linalg.norm(values[3:]))}


def _length(values: Array, covariance: Array) -> tuple[float, float]:
    size = float(np.linalg.norm(values))
    along = values / size if size > 0 else np.zeros_like(values)
    return size, float(np.sqrt(along @ covariance @ along))
