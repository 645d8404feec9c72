"""An interim check as results: what `verify calibrate check -o` leaves.

The keys of the summary and the tables are those that `reports.check` documents.
"""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from reports import Results
from verify.analysis.rig_check.check import FIGURES
from verify.calibration.check.check import P_CONFIDENCE, CheckResult, figure_limit
from verify.calibration.origin import DEG, MM, ResultsOrigin

FACTORS = np.array([1e3, 1.0, DEG])  # of the figures in the results; mm_per_m leads to one unit
NAMES = ("scale_permille", "vertical_px", "roll_deg")


def check_results(found: CheckResult, origin: ResultsOrigin | None = None) -> Results:
    """Lay an interim check of a session or of pictures out for the report."""
    figures, each = found.found, found.lengths
    square = None if found.square is None else [MM * size for size in found.square]
    sizes = np.array([figures.value * FACTORS, figures.uncertainty * FACTORS, figures.z])
    keys = ("known_mm", "measured_mm", "standard_uncertainty_mm")
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
            "figures": [
                {
                    "figure": name,
                    key: x,
                    f"standard_uncertainty_{key.rpartition('_')[2]}": u,
                    "z": z,
                }
                for name, key, x, u, z in zip(FIGURES, NAMES, *sizes.tolist(), strict=True)
            ],
            "mm_per_m": dict(zip(FIGURES, (figures.per_metre / FACTORS).tolist(), strict=True)),
            "square": square and dict(zip(keys, square, strict=True)),
            "visible": [
                {"change": change, "smallest": smallest, "unit": unit}
                for change, (smallest, unit) in found.visible.items()
            ],
            "uncounted": list(found.uncounted),
            "decisions": list(found.decisions),
        },
        setup={},
        tables={
            "lengths": pd.DataFrame(
                {
                    "ends": [" to ".join(ends) for ends in each.ends],
                    "known_mm": each.known * MM,
                    "measured_mm": each.measured * MM,
                    "error_mm": (each.measured - each.known) * MM,
                    "standard_uncertainty_mm": each.uncertainty * MM,
                    "pairs": each.pairs,
                }
            ),
            "pairs": _table("frame", figures.frame, figures.series),
            "sources": _table("source", [*figures.by_source], [*figures.by_source.values()]),
        },
    )


def _table(key: str, of: ArrayLike, figures: ArrayLike) -> pd.DataFrame:
    """Lay out figures, a row for each pair or standard uncertainties for each source."""
    columns = np.reshape(figures, (-1, len(NAMES))) * FACTORS
    return pd.DataFrame({key: of, **dict(zip(NAMES, columns.T, strict=True))})
