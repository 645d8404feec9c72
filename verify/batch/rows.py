"""One session's results as a row of sessions.parquet: summary.json, flattened."""

import hashlib
import json
from datetime import UTC, datetime
from typing import Any

from reports import Results
from verify.batch.schema import FLANGE, JOINT, STATUSES
from verify.judgement.budget import ALIGNMENT, CLOCK, PAN

_SWEPT = ("pan_min_deg", "pan_max_deg")  # of the session, not of the calibration


def row(results: Results, kept_in: str) -> dict[str, Any]:
    """Flatten a session's results.

    Args:
        results: as they were kept.
        kept_in: where, below OUT.

    Returns:
        What `schema.sessions` names; columns that are missing are null.
    """
    summary, setup = results.summary, results.setup
    session, pairs, clock = summary["session"], summary["pairs"], summary["clock"]
    flat: dict[str, Any] = {
        "session": session["path"],
        "robot": session["robot"],
        "description": session["description"],
        "started": moment(session["started"]),
        "kept_in": kept_in,
        "tool_version": summary["tool"]["version"],
        "calibration": calibration(setup),
        "base_source": setup["rig"].get("base_source"),
        "registration": setup["rig"].get("registration"),
        "robot_fingerprint": setup["robot"].get("fingerprint"),
        "joints": len(summary["joints"]),
        "pairs_recorded": pairs["recorded"],
        "pairs_measured": pairs["measured"],
        **{f"rejected_{name}": pairs["rejected"].get(name, 0) for name in STATUSES},
        "clock_encoder_offset_s": clock["encoder_offset_s"],
        "clock_standard_uncertainty_s": clock["standard_uncertainty_s"],
        "clock_source": clock["source"],
        "clock_observable": clock["observable"],
        "verdict": summary["verdict"],
        "decision_rule": summary["decision_rule"],
        "joint_error_correlation": [c for line in summary["joint_error_correlation"] for c in line],
        "diagnosis": summary["diagnosis"],
        "uncounted": summary["budget"]["uncounted"],
        "inputs": [{"file": f, "digest": d} for f, d in sorted(summary["inputs"].items())],
        "warnings": summary["warnings"],
        "known_dof": summary["known_dof"],
    }
    own = _own(results)
    for entry in summary["joints"]:
        name = f"q{entry['joint']}"
        flat |= {f"{name}_{key}": entry.get(key) for key, _ in JOINT}
        flat[f"{name}_session_uncertainty_deg"] = own.get(entry["joint"])
    for part, _unit in FLANGE:
        flat |= {f"{part}_{key}": value for key, value in summary[part].items()}
    return flat


def moment(text: str | None) -> datetime | None:
    """Read when a session started; a time without a zone is taken as UTC."""
    if text is None:
        return None
    read = datetime.fromisoformat(text)
    return read.replace(tzinfo=UTC) if read.tzinfo is None else read.astimezone(UTC)


def calibration(setup: dict[str, Any]) -> str:
    """Give sessions measured with the same rig, registration and marker the same short text."""
    rig = dict(setup["rig"])
    for side in ("left", "right"):
        rig[side] = {k: v for k, v in rig.get(side, {}).items() if k not in _SWEPT}
    text = json.dumps([rig, setup["marker"]], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _own(results: Results) -> dict[int, float]:
    """The part of each joint's standard uncertainty that every session draws anew, degrees.

    Pixels, readings, and how the instants were brought together; rig, base and marker are shared
    by all sessions of one calibration.
    """
    budget = results.table("budget")
    if not len(budget):
        return {}
    anew = (budget["kind"] == "random") | budget["source"].isin([ALIGNMENT, CLOCK, PAN])
    chosen = budget[anew]
    square = (chosen["standard_uncertainty_deg"] ** 2).groupby(chosen["joint"]).sum(min_count=1)
    return {int(str(joint)): float(value**0.5) for joint, value in square.items()}
