"""Opening a port while a control loop goes on: in a thread of its own."""

import contextlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from verify.devices.ports import Port

QUICK = 0.005  # s: a port in this room is open by then, and nobody has to ask again


class BackgroundOpening:
    """Opens a port without making anybody wait for a computer that does not answer.

    Args:
        open_port: opens it; may take a second.
    """

    def __init__(self, open_port: Callable[[], Port]) -> None:
        self._open_port = open_port
        self._worker = ThreadPoolExecutor(1, "opening")
        self._opening: Future[Port] | None = None
        self._failed: OSError | None = None  # the last time

    def __call__(self) -> Port:
        """Give the port once it is open.

        Raises:
            OSError: not yet, or it cannot be opened now; while it is tried again, what went wrong
                the last time.
        """
        opening = self._opening or self._worker.submit(self._open_port)
        self._opening = opening
        with contextlib.suppress(TimeoutError):  # what went wrong there is raised below
            opening.exception(QUICK)
        if not opening.done():
            raise self._failed or BlockingIOError(0, "the port is being opened")
        self._opening = None
        try:
            port = opening.result()
        except OSError as failed:
            self._failed = failed
            raise
        self._failed = None
        return port

    def close(self) -> None:
        """Open nothing any more."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        if self._opening is not None:
            self._opening.add_done_callback(_close_again)


def _close_again(opening: Future[Port]) -> None:
    if not opening.cancelled() and opening.exception() is None:
        opening.result().close()
