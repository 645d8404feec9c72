"""The state of a run as text for Prometheus.

Source: Prometheus, "Exposition formats", text version 0.0.4.
"""

import math
from collections.abc import Iterable, Mapping

from verify.live.state import LiveState

Labels = Mapping[str, str]


def exposition(state: LiveState) -> str:
    """Word the state, a family of samples at a time."""
    now = state.snapshot()
    text = [
        _family("verify_pairs_total", "counter", "Pairs by what became of them.",
                [({"status": s}, n) for s, n in sorted(state.statuses().items())]),
        _family("verify_dropped_total", "counter", "Pictures and pairs that were not measured.",
                [({"reason": r}, n) for r, n in sorted(now.dropped.items())]),
        _family("verify_pair_rate_hertz", "gauge", "Pairs a second.", [({}, now.rate)]),
        _family("verify_latency_seconds", "gauge", "From evidence to joint error.",
                [({"quantile": q}, value) for q, value in
                 (("0.5", now.latency.p50), ("0.99", now.latency.p99)) if value is not None]),
        _family("verify_device_up", "gauge", "1 where a device gives something.",
                [({"device": line.name}, int(line.well)) for line in now.devices]),
        _family("verify_alarms_total", "counter", "Alarms so far, by kind.",
                [({"kind": k}, n) for k, n in sorted(now.alarm_counts.items())]),
        _family("verify_alarms_standing", "gauge", "Alarms that stand.",
                [({}, sum(a.ended is None and a.kind != "change" for a in now.alarms))]),
    ]  # fmt: skip
    row = now.row
    if row is not None:
        joints = [{"joint": str(j + 1)} for j in range(len(row.error))]
        for name, said, values in (
            ("verify_joint_error_degrees", "Reading less measured angle.", row.error),
            ("verify_joint_error_standard_uncertainty_degrees", "1σ.", row.uncertainty),
        ):
            degrees = [math.degrees(v) for v in values.tolist()]
            told = [(j, v) for j, v in zip(joints, degrees, strict=True) if math.isfinite(v)]
            text.append(_family(name, "gauge", said, told))
        if row.clock is not None:
            text.append(
                _family("verify_clock_offset_seconds", "gauge", "Added to the readings' time.",
                        [({"source": row.clock.source}, row.clock.offset)])
            )  # fmt: skip
    return "".join(text)


def _family(name: str, kind: str, said: str, samples: Iterable[tuple[Labels, float]]) -> str:
    lines = [f"# HELP {name} {said}", f"# TYPE {name} {kind}"]
    for labels, value in samples:
        pairs = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        lines.append(f"{name}{'{' + pairs + '}' if pairs else ''} {value:.9g}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
