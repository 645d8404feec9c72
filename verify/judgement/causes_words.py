"""Causes as entries of summary.json, in the units of docs/results.md."""

import math
from typing import Any

from verify.judgement.causes import Candidate, Cause
from verify.judgement.faults import SCALES, Fault


def entry_of(cause: Cause) -> dict[str, Any]:
    """One entry of `diagnosis`."""
    scale = SCALES[cause.unit]
    entry: dict[str, Any] = {
        "joint": cause.joint,
        "kind": cause.kind,
        "value": _number(cause.value * scale),
        "unit": cause.unit or None,
        "standard_uncertainty": _number(cause.standard_uncertainty * scale),
        "expanded_uncertainty": _number(2 * cause.standard_uncertainty * scale),
        "explains": cause.explains,
    }
    if cause.candidates:
        entry["candidates"] = [_candidate(c) for c in cause.candidates]
        entry["separating_motion"] = cause.motion
        entry["separating_joints"] = list(cause.joints)
    else:
        entry |= _more(cause.fault)
        entry |= {f"{what}_deg": math.degrees(angle) for what, angle in cause.details.items()}
    if cause.runner_up is not None:
        entry["runner_up"] = _candidate(cause.runner_up) | {"advantage": cause.runner_up.advantage}
    return entry


def _candidate(candidate: Candidate) -> dict[str, Any]:
    scale = SCALES[candidate.fault.unit]
    return {
        "joint": candidate.joint,
        "kind": candidate.kind,
        **_more(candidate.fault),
        "value": _number(candidate.value * scale),
        "unit": candidate.fault.unit or None,
        "expanded_uncertainty": _number(2 * candidate.standard_uncertainty * scale),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _more(fault: Fault) -> dict[str, Any]:
    more: dict[str, Any] = {}
    if fault.parameter is not None:
        more["parameter"] = fault.parameter
    if fault.per_turn is not None:
        more["per_turn"] = fault.per_turn
    return more
