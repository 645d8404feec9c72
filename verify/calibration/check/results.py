"""An interim check as results: what `verify calibrate check -o` leaves.

The keys of the summary and the tables are those that `reports.calibration.check` documents.
"""

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from reports import Results
from verify.analysis.rig_check.check import FIGURES, RigConsistency
from verify.calibration.check.check import P_CONFIDENCE, CheckResult, figure_limit
from verify.calibration.origin import DEG, MM, ResultsOrigin

UNITS = np.array([1e3, 1.0, DEG])  # of the figures in the results; mm_per_m leads to one unit
NAMES = ("scale_permille", "vertical_px", "roll_deg")


def check_results(found: CheckResult, origin: ResultsOrigin | None = None) -> Results:
    """Lay an interim check of a session or of pictures out for the report."""
    figures = found.found
    return Results(
        summary={
            **(origin or ResultsOrigin()).summary("calibration"),
            "method": "check",
            "warnings": list(found.warnings),
            "verdict": found.verdict,
            "displaced_led": found.displaced,
            "confidence": P_CONFIDENCE,
            "limit": figure_limit(figures),
            "pairs": {"used": len(figures.frame), "left_out": list(figures.left_out)},
            "reprojection": {"rms_px": found.reprojection_rms_px},
            "figures": _figures(figures),
            "mm_per_m": dict(zip(FIGURES, (figures.per_metre / UNITS).tolist(), strict=True)),
            "square": _square(found.square),
            "visible": [
                {"change": change, "smallest": smallest, "unit": unit}
                for change, (smallest, unit) in found.visible.items()
            ],
            "uncounted": list(found.uncounted),
            "decisions": list(found.decisions),
        },
        setup={},
        tables={
            "lengths": _lengths(found),
            "pairs": _table("frame", figures.frame, figures.series),
            "sources": _table("source", [*figures.by_source], [*figures.by_source.values()]),
        },
    )


def _figures(found: RigConsistency) -> list[dict[str, Any]]:
    figures = np.array([found.value * UNITS, found.uncertainty * UNITS, found.z])
    return [
        {"figure": name, key: value, f"standard_uncertainty_{key.rpartition('_')[2]}": u, "z": z}
        for name, key, (value, u, z) in zip(FIGURES, NAMES, figures.T.tolist(), strict=True)
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


def _table(key: str, of: ArrayLike, figures: ArrayLike) -> pd.DataFrame:
    """Lay out figures, a row for each pair or standard uncertainties for each source."""
    columns = np.reshape(figures, (-1, len(NAMES))) * UNITS
    return pd.DataFrame({key: of, **dict(zip(NAMES, columns.T, strict=True))})
