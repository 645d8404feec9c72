"""Single-joint sweeps as summary.json and tables have them: degrees, null for what is not known."""

from typing import Any

import numpy as np
import pandas as pd

from verify.judgement.budget_words import known
from verify.judgement.sweep_terms import Figure
from verify.judgement.sweeps import Sweep
from verify.records import Array

COLUMNS = [
    "sweep", "joint", "frame", "angle_deg", "direction", "error_deg", "u_deg", "curve_deg",
]  # fmt: skip


def sweep_entries(found: list[Sweep], frame: Array) -> list[dict[str, Any]]:
    """One entry a sweep for summary.json; `frame` (n,) numbers the compared pairs."""
    return [
        {
            "joint": sweep.joint + 1,
            "pairs": len(sweep.rows),
            "first_frame": int(frame[sweep.rows[0]]),
            "last_frame": int(frame[sweep.rows[-1]]),
            "outlying_frames": [int(f) for f in frame[sweep.outlying]],
            "span_deg": known(np.rad2deg(sweep.span)),
            "both_directions": len(np.unique(sweep.direction)) > 1,
            "gain": known(sweep.gain.value),
            "gain_standard_uncertainty": known(sweep.gain.uncertainty),
            **_degrees("hysteresis", sweep.hysteresis),
            **_degrees("eccentricity", sweep.eccentricity),
            **_degrees("eccentricity_phase", sweep.phase),
            "eccentricity_beyond_chance": sweep.eccentric,
            **_degrees("nonlinearity_rms", sweep.nonlinearity),
            "noise_rms_deg": known(np.rad2deg(sweep.noise)),
            "nonlinearity_p_value": known(sweep.nonlinear_p),
            "wobble_rms_mm": known(sweep.wobble[0] * 1e3),
            "wobble_rms_deg": known(np.rad2deg(sweep.wobble[1])),
            "wobble_p_value": known(sweep.wobble_p),
        }
        for sweep in found
    ]


def _degrees(name: str, figure: Figure) -> dict[str, float | None]:
    return {
        f"{name}_deg": known(np.rad2deg(figure.value)),
        f"{name}_standard_uncertainty_deg": known(np.rad2deg(figure.uncertainty)),
    }


def sweeps_table(found: list[Sweep], frame: Array) -> pd.DataFrame:
    """One row a pair of a sweep; `frame` (n,) numbers the compared pairs."""
    rows = []
    for number, sweep in enumerate(found, start=1):
        columns = (
            frame[sweep.rows], np.rad2deg(sweep.q), sweep.direction, np.rad2deg(sweep.error),
            np.rad2deg(sweep.uncertainty), np.rad2deg(sweep.curve),
        )  # fmt: skip
        rows += [(number, sweep.joint + 1, *values) for values in zip(*columns, strict=True)]
    return pd.DataFrame(rows, columns=COLUMNS)
