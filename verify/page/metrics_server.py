"""Metrics at an address of their own, for Prometheus where no page is wanted."""

import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from verify.errors import InputError

PATIENCE = 5.0  # s for a request; who says nothing is let go


class MetricsServer:
    """Answers GET /metrics, and nothing else.

    Args:
        address: HOST:PORT, of this computer.
        text: makes the answer.

    Raises:
        InputError: no such address, or it is taken.
    """

    def __init__(self, address: str, text: Callable[[], str]) -> None:
        host, _, port = address.rpartition(":")
        if not host or not port.isdecimal():
            expected = "HOST:PORT is expected"
            raise InputError("alarm.prometheus", f'is "{address}"', expected, "Mend it.")
        try:
            self._server = ThreadingHTTPServer((host.strip("[]"), int(port)), _handler(text))
        except (OSError, OverflowError) as error:
            remedy = "Choose another port."
            found = f"cannot be served: {error}"
            raise InputError(f"alarm.prometheus, {address}", found, "", remedy) from error
        self._server.daemon_threads = True
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._server.server_address[1])

    def close(self) -> None:
        """Answer no more."""
        self._server.shutdown()
        self._server.server_close()


def _handler(text: Callable[[], str]) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE

        def do_GET(self) -> None:
            """Give the metrics; no script of a web page may read them."""
            foreign = self.headers.get("Origin") is not None
            status = 403 if foreign else 200 if self.path == "/metrics" else 404
            body = text().encode() if status == 200 else b""
            self.send_response(status)
            self.send_header("Content-Type", "text/plain; version=0.0.4; charset=utf-8")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            """Say nothing: the terminal is the run's."""

    return Handler
