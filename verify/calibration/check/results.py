"""An interim check as results: what `verify calibrate check -o` leaves.

The keys of the summary and the tables are those that `reports.calibration.check` documents.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from reports import Results
from verify.analysis.rig_check import FIGURES, RigConsistency
from verify.calibration.check.check import P_CONFIDENCE, CheckResult, figure_limit
from verify.core.records import Array
from verify.core.version import __version__

MM = 1e3
UNITS = np.array([1e3, 1.0, 180 / np.pi])  # of the figures, in which they are told
NAMES = ("scale_permille", "vertical_px", "roll_deg")


def check_results(
    found: CheckResult,
    *,
    source: str = "",
    description: str = "",
    inputs: Mapping[str, str] | None = None,
) -> Results:
    """Lay an interim check out for the report.

    Args:
        found: what was checked, and whether it holds.
        source: folder of the session or of the pictures.
        description: a user's words on it.
        inputs: files that were read, with their hashes.
    """
    figures = found.found
    return Results(
        summary={
            "format": 1,
            "kind": "calibration",
            "method": "check",
            "tool": {"name": "verify", "version": __version__},
            "source": {"path": source, "description": description},
            "inputs": dict(sorted((inputs or {}).items())),
            "warnings": list(found.warnings),
            "verdict": found.verdict,
            "confidence": P_CONFIDENCE,
            "limit": figure_limit(figures),
            "pairs": {"used": len(figures.frame), "left_out": list(figures.left_out)},
            "reprojection": {"rms_px": found.reprojection_rms_px},
            "figures": _figures(figures),
            "square": _square(found.square),
            "visible": [
                {"change": v.change, "smallest": v.smallest, "unit": v.unit} for v in found.visible
            ],
            "uncounted": list(found.uncounted),
            "decisions": list(found.decisions),
        },
        setup={},
        tables={
            "lengths": _lengths(found),
            "pairs": _pairs(figures),
            "sources": _sources(figures),
        },
    )


def _figures(found: RigConsistency) -> list[dict[str, Any]]:
    return [
        {
            "figure": name,
            key: value,
            f"standard_uncertainty_{unit}": u,
            "z": z,
        }
        for name, key, unit, value, u, z in zip(
            FIGURES,
            NAMES,
            (name.rpartition("_")[2] for name in NAMES),
            (found.value * UNITS).tolist(),
            (found.uncertainty * UNITS).tolist(),
            found.z.tolist(),
            strict=True,
        )
    ]


def _square(square: tuple[float, float, float] | None) -> dict[str, float] | None:
    if square is None:
        return None
    known, measured, u = (MM * value for value in square)
    return {"known_mm": known, "measured_mm": measured, "standard_uncertainty_mm": u}


def _lengths(found: CheckResult) -> pd.DataFrame:
    each = found.lengths
    return pd.DataFrame(
        {
            "ends": [" to ".join(ends) for ends in each.ends],
            "known_mm": each.known * MM,
            "measured_mm": each.measured * MM,
            "error_mm": (each.measured - each.known) * MM,
            "standard_uncertainty_mm": each.uncertainty * MM,
            "pairs": each.pairs,
        }
    )


def _pairs(found: RigConsistency) -> pd.DataFrame:
    """The figures of single pairs, in their order."""
    values: Array = found.series.reshape(-1, len(NAMES)) * UNITS
    columns = {name: values[:, i] for i, name in enumerate(NAMES)}
    return pd.DataFrame({"frame": found.frame, **columns})


def _sources(found: RigConsistency) -> pd.DataFrame:
    """Standard uncertainty of each figure from each source."""
    rows = np.array(list(found.by_source.values())).reshape(-1, len(NAMES)) * UNITS
    columns = {name: rows[:, i] for i, name in enumerate(NAMES)}
    return pd.DataFrame({"source": list(found.by_source), **columns})
