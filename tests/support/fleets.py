"""Small fleets: simulated sessions on the disk, and drawn rows of sessions.parquet."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd

from verify.simulation import library
from verify.simulation.scenario import ScenarioClock, ScenarioFault
from verify.simulation.session.folder import write_session
from verify.simulation.session.simulate import simulate_session

PAIRS = 10
BEGIN = datetime(2025, 1, 1, tzinfo=UTC)
YEAR, MONTH = 365.0, 365.25 / 12  # days
NO_FAILURES = pd.DataFrame({"session": [], "kind": [], "why": []}, dtype=str)


def record(folder: Path, seed: int, fault: ScenarioFault | None = None, day: float = 0.0) -> Path:
    """Simulate a short session through pixels."""
    scenario = library.load("multi_joint_fault_6r")
    recording = msgspec.structs.replace(scenario.recording, pairs=PAIRS)
    scenario = msgspec.structs.replace(
        scenario,
        seed=seed,
        recording=recording,
        fault=[] if fault is None else [fault],
        clock=ScenarioClock(encoder_offset_standard_uncertainty_s=0.0005),
    )
    folder.mkdir(parents=True)
    write_session(simulate_session(scenario), folder)
    facts = folder / "session.toml"
    started = (BEGIN + timedelta(days=day)).strftime("%Y-%m-%dT%H:%M:%SZ")
    lines = [line for line in facts.read_text().splitlines() if not line.startswith("started")]
    at = next(i for i, line in enumerate(lines) if line.startswith("robot"))
    facts.write_text("\n".join([*lines[: at + 1], f"started = {started}", *lines[at + 1 :], ""]))
    return folder


def rows(
    seed: int,
    *,
    sessions: int = 100,
    drift: float = 0.0,
    step: float = 0.0,
    calibrations: int = 1,
    scatter: float = 1.0,
    shared: float = 0.05,
) -> pd.DataFrame:
    """Draw a year of three arms: joint 3 of arm_a drifts (deg a month), joint 5 of arm_b steps.

    Args:
        seed: the only source of chance.
        sessions: of each arm.
        drift: degrees a month.
        step: degrees, from 10 June on.
        calibrations: how many in the year; each has an error of its own, `shared`.
        scatter: how many times more the sessions scatter than they state.
        shared: degrees, standard uncertainty of a calibration.
    """
    rng = np.random.default_rng(seed)
    tables = []
    for arm in ("arm_a", "arm_b", "arm_c"):
        t = np.sort(rng.uniform(0, YEAR, sessions))
        calibration = np.minimum((t / YEAR * calibrations).astype(int), calibrations - 1)
        own = rng.uniform(0.015, 0.04, (sessions, 6))
        error = rng.normal(0, shared, (calibrations, 6))[calibration]
        error = error + scatter * own * rng.normal(size=(sessions, 6))
        if arm == "arm_a":
            error[:, 2] += drift * t / MONTH
        if arm == "arm_b":
            error[:, 4] += step * (t >= 160)
        tables.append(_table(arm, t, calibration, own, error, shared))
    return pd.concat(tables, ignore_index=True)


def _table(
    arm: str,
    t: np.ndarray,
    calibration: np.ndarray,
    own: np.ndarray,
    error: np.ndarray,
    shared: float,
) -> pd.DataFrame:
    n = len(t)
    names = [f"lab/{arm}/{i:03d}" for i in range(n)]
    table: dict[str, object] = {
        "session": names,
        "robot": [arm] * n,
        "started": pd.Timestamp(BEGIN) + pd.to_timedelta(t, unit="D"),
        "kept_in": [f"sessions/{i}" for i in range(n)],
        "calibration": [f"{arm}-{c}" for c in calibration],
        "serial_number": pd.Series([None] * n, dtype=object),
        "joints": [6] * n,
        "pairs_recorded": [60] * n,
        "pairs_measured": [60] * n,
        "verdict": [np.nan] * n,
    }
    for j in range(6):
        q = f"q{j + 1}"
        table |= {
            f"{q}_mean_error_deg": error[:, j],
            f"{q}_standard_uncertainty_deg": np.hypot(own[:, j], shared),
            f"{q}_session_uncertainty_deg": own[:, j],
            f"{q}_verdict": [np.nan] * n,
            f"{q}_coverage_factor": [2.0] * n,
            f"{q}_worst_error_deg": error[:, j],
            f"{q}_worst_error_standard_uncertainty_deg": own[:, j],
            f"{q}_visible_fraction": [1.0] * n,
            f"{q}_visible_fraction_since_registration": [1.0] * n,
            f"{q}_minimum_detectable_error_deg": [0.1] * n,
            f"{q}_minimum_separable_error_deg": [0.2] * n,
        }
    return pd.DataFrame(table)
