"""The state of a run as text for Prometheus, and a server for it where no page is served.

Source: Prometheus, "Exposition formats", text version 0.0.4.
"""

import math
import socket
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import partial

from verify.errors import InputError
from verify.live.page.access import PageAccess, is_loopback
from verify.live.state import LiveState

Labels = Mapping[str, str]
JOIN_TIMEOUT = 2.0  # s, for an answer under way


def exposition(state: LiveState) -> str:
    """Word the state, a family of samples at a time."""
    now = state.snapshot()
    text = [
        _family("verify_pairs_total", "counter", "Pairs by status.",
                [({"status": s}, n) for s, n in sorted(state.statuses().items())]),
        _family("verify_dropped_total", "counter", "Pictures and pairs that were not measured.",
                [({"reason": r}, n) for r, n in sorted(now.dropped.items())]),
        _family("verify_pair_rate_hertz", "gauge", "Pairs per second.", [({}, now.rate)]),
        _family("verify_latency_seconds", "gauge", "Latency from the evidence to the joint error.",
                [({"quantile": q}, value)
                 for q, value in zip(("0.5", "0.99"), now.latency or (), strict=False)]),
        _family("verify_device_up", "gauge", "1 where a device delivers data.",
                [({"device": line.name}, int(line.well)) for line in now.devices]),
        _family("verify_alarms_total", "counter", "Alarms so far, by kind.",
                [({"kind": k}, n) for k, n in sorted(now.alarm_counts.items())]),
        _family("verify_alarms_standing", "gauge", "Active alarms.",
                [({}, sum(a.ended is None and a.kind != "change" for a in now.alarms))]),
    ]  # fmt: skip
    row = now.row
    if row is not None:
        joints = [{"joint": str(j + 1)} for j in range(len(row.error))]
        for name, meaning, values in (
            ("verify_joint_error_degrees", "Reading less measured angle.", row.error),
            ("verify_joint_error_standard_uncertainty_degrees", "1σ.", row.uncertainty),
        ):
            degrees = [math.degrees(v) for v in values.tolist()]
            samples = [(j, v) for j, v in zip(joints, degrees, strict=True) if math.isfinite(v)]
            text.append(_family(name, "gauge", meaning, samples))
        if row.clock is not None:
            text.append(
                _family("verify_clock_offset_seconds", "gauge", "Added to the readings' time.",
                        [({"source": row.clock.source}, row.clock.offset)])
            )  # fmt: skip
    return "".join(text)


def _family(name: str, kind: str, meaning: str, samples: Iterable[tuple[Labels, float]]) -> str:
    lines = [f"# HELP {name} {meaning}", f"# TYPE {name} {kind}"]
    for labels, value in samples:
        pairs = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        lines.append(f"{name}{'{' + pairs + '}' if pairs else ''} {value:.9g}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


class MetricsServer:
    """Answers GET /metrics at HOST:PORT of this computer with a text, and nothing else.

    Raises:
        InputError: no such address, or it is taken.
    """

    def __init__(self, address: str, text: Callable[[], str]) -> None:
        import uvicorn  # here: no other run needs a server in this process
        from starlette.applications import Starlette
        from starlette.requests import Request
        from starlette.responses import PlainTextResponse
        from starlette.routing import Route

        from verify.live.page.server import TimedHttp

        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal():
            expected = "HOST:PORT is expected"
            raise InputError("alarm.prometheus", f'is "{address}"', expected, "Correct it.")
        host = host.strip("[]")
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            listening = socket.create_server((host, int(port)), family=family)
        except (OSError, OverflowError) as error:
            remedy = "Choose another port."
            found = f"cannot be served: {error}"
            raise InputError(f"alarm.prometheus, {address}", found, "", remedy) from error
        self.port = int(listening.getsockname()[1])  # where it listens
        access = PageAccess(host, self.port, None)

        async def metrics(request: Request) -> PlainTextResponse:
            """Give the metrics; no script of a web page may read them, whatever name it takes."""
            headers = request.headers
            refused = is_loopback(host) and access.refusal(headers, None, script=False)
            if "origin" in headers or refused:
                return PlainTextResponse("", 403)
            return PlainTextResponse(text(), media_type="text/plain; version=0.0.4")

        config = uvicorn.Config(
            Starlette(routes=[Route("/metrics", metrics)]), http=TimedHttp, lifespan="off",
            log_level="critical", access_log=False, server_header=False,
            timeout_graceful_shutdown=1,
        )  # fmt: skip
        self._server = uvicorn.Server(config)
        run = partial(self._server.run, [listening])
        self._thread = threading.Thread(target=run, name="metrics", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer no more."""
        self._server.should_exit = True
        self._thread.join(JOIN_TIMEOUT)
