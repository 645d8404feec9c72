"""A second process for work that must not take the measurement's time: one question at once."""

import gc
import multiprocessing
import signal
import threading
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

from verify.priority import stand_back

Question = TypeVar("Question")
Answer = TypeVar("Answer")
START_LIMIT = 60.0  # s
GOODBYE = 1.0  # s that it is given to end by itself


class HelperLostError(Exception):
    """The second process is gone, or its work failed; the words say why."""


class HelperLateError(HelperLostError):
    """Its answer takes longer than one would wait."""


class Helper(Generic[Question, Answer]):
    """Answers questions in a process of its own, which ends when this one does.

    Args:
        function: an importable function; question and answer are pickled.
        name: what a list of processes calls it.
        aside: it stands back where others want the processor too.
        prepare: called there before it is ready.
    """

    def __init__(
        self,
        function: Callable[[Question], Answer],
        name: str,
        *,
        aside: bool = False,
        prepare: Callable[[], object] | None = None,
    ) -> None:
        # not forked: a copy of a process with threads and cameras is no sound one
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(function, theirs, aside, prepare), name=name, daemon=True
        )
        self._process.start()
        theirs.close()
        self._lock = threading.Lock()
        self._ready = self._owes = False

    @property
    def pid(self) -> int:
        """Number of the process."""
        assert self._process.pid is not None  # it was started
        return self._process.pid

    def wait_until_ready(self) -> None:
        """Wait until it has imported what it needs, which a busy machine takes seconds for.

        Raises:
            HelperLostError: it does not start.
        """
        if not self._ready:
            received(self._connection, START_LIMIT)
            self._ready = True

    def is_ready(self) -> bool:
        """Whether it can be asked without a wait for its start.

        Raises:
            HelperLostError: it did not start.
        """
        with self._lock:
            if not self._ready and self._connection.poll(0.0):
                self.wait_until_ready()
            return self._ready

    def ask(self, question: Question, patience: float) -> Answer:
        """Ask, and wait for the answer.

        Args:
            question: what the function takes.
            patience: s.

        Raises:
            HelperLateError: no answer came so soon, or there is none yet to the question before.
            HelperLostError: the work failed, or nobody is there.
        """
        with self._lock:
            self.begin(question)
            return self.finish(patience)

    def begin(self, question: Question) -> None:
        """Hand over a question; `finish` waits for its answer.

        Raises:
            HelperLateError: the question before, which nobody waits for any more, is still being
                answered; later it can be asked again.
            HelperLostError: nobody is there.
        """
        self.wait_until_ready()
        if self._owes:
            self.finish(0.0)
        try:
            self._connection.send(question)
        except (OSError, ValueError) as error:
            raise HelperLostError(str(error)) from error
        self._owes = True

    def finish(self, patience: float) -> Answer:
        """Wait for the answer to `begin`'s question.

        Raises:
            HelperLateError: none came so soon.
            HelperLostError: the work failed, or nobody is there.
        """
        answer: Answer = received(self._connection, patience)[1]
        self._owes = False
        return answer

    def close(self) -> None:
        """Let it end."""
        self._connection.close()
        end(self._process, GOODBYE)


def received(connection: Connection, patience: float) -> tuple[str, Any]:
    """Wait for what another process says: of what kind, and what.

    Args:
        connection: to it.
        patience: s.

    Raises:
        HelperLateError: it said nothing.
        HelperLostError: it is gone, or says that it failed.
    """
    try:
        if not connection.poll(patience):
            raise HelperLateError(f"no answer within {patience:g} s")
        kind, value = connection.recv()
    except (OSError, EOFError) as error:
        raise HelperLostError(str(error) or "the process has ended") from error
    if kind == "failed":
        raise HelperLostError(str(value))
    return kind, value


def end(process: BaseProcess, goodbye: float) -> None:
    """End a process whose connection is closed; it is given so many s to do so by itself."""
    process.join(goodbye)
    if process.is_alive():
        process.terminate()
        process.join(goodbye)


def _serve(
    function: Callable[[Any], Any],
    connection: Connection,
    aside: bool,
    prepare: Callable[[], object] | None,
) -> None:
    """Answer until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asks
    if aside:
        stand_back()
    try:
        if prepare is not None:
            prepare()
    except Exception as error:
        with suppress(OSError):
            connection.send(_failed(error))
        return
    gc.freeze()  # what was imported is no garbage: looking through it would take a picture's time
    with suppress(OSError):
        connection.send(("ready", None))
    while True:
        try:
            question = connection.recv()
        except (EOFError, OSError):
            return
        try:
            answer = ("done", function(question))
        except Exception as error:
            answer = _failed(error)
        try:
            connection.send(answer)
        except OSError:
            return


def _failed(error: Exception) -> tuple[str, str]:
    return "failed", f"{type(error).__name__}: {error}"
