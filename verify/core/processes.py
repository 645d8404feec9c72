"""A second process for work that must not take the measurement's time: one question at once.

Who computes when and where: pictures for lookers-on may be late, a measurement may not.

A picture where two processes see it.
"""

import ctypes
import gc
import math
import multiprocessing
import os
import signal
import struct
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.shared_memory import SharedMemory
from typing import Any, Generic, TypeVar

import numpy as np

from verify.core.records import Image

NICENESS = 10
SHORT_SLICE_NS, DEFAULT_SLICE_NS = (
    100_000,
    0,
)  # ns of a turn: the shortest that Linux grants; by default it is 3 ms
SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # numbers of the system call
# size, policy, flags, niceness, priority, turn in ns, two for deadlines: linux/sched/types.h
ATTRIBUTES = struct.Struct("=IIQiIQQQ")


def lower_priority() -> None:
    """Let others have the processor first, from now on, in this thread and those it starts.

    Where niceness belongs to the whole process, which is everywhere but on Linux, nothing changes.
    """
    if sys.platform == "linux":
        os.nice(NICENESS)
        with suppress(PermissionError):  # some sandboxes; niceness remains
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def request_short_slice(*, wanted: bool = True) -> bool:
    """Let this thread have the processor as soon as it is woken, for short turns at a time.

    Linux, from 6.12 on, lets whoever asks for shorter turns interrupt those with longer ones; that
    takes no right, as the share of the processor stays what it is. Elsewhere nothing changes.

    Args:
        wanted: False takes it back.

    Returns:
        Whether the system took the call; one before 6.12 takes it, and does nothing.
    """
    number = SCHED_SETATTR.get(os.uname().machine) if sys.platform == "linux" else None
    if number is None:
        return False
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    turn = SHORT_SLICE_NS if wanted else DEFAULT_SLICE_NS
    told = ATTRIBUTES.pack(ATTRIBUTES.size, os.SCHED_OTHER, 0, niceness, 0, turn, 0, 0)
    return bool(_c_library().syscall(number, 0, told, 0) == 0)


@lru_cache(maxsize=1)
def _c_library() -> ctypes.CDLL:
    return ctypes.CDLL(None)


def split_processors(other: int) -> None:
    """Give this thread one half of the processors, and another process (its id) the other half.

    A process that is asked something tends to be woken where the one who asks runs; two that are
    to work at once then take turns, until the scheduler notices.
    """
    if sys.platform != "linux":
        return
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) < 2:
        return
    half = len(usable) // 2
    with suppress(ProcessLookupError, PermissionError):
        os.sched_setaffinity(other, usable[half:])
        os.sched_setaffinity(0, usable[:half])


Question = TypeVar("Question")
Answer = TypeVar("Answer")
START_TIMEOUT = 60.0  # s
JOIN_TIMEOUT = 1.0  # s that it is given to end by itself


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
            receive(self._connection, START_TIMEOUT)
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
        answer: Answer = receive(self._connection, patience)[1]
        self._owes = False
        return answer

    def close(self) -> None:
        """Let it end."""
        self._connection.close()
        end_process(self._process, JOIN_TIMEOUT)


def receive(connection: Connection, patience: float) -> tuple[str, Any]:
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


def end_process(process: BaseProcess, goodbye: float) -> None:
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
        lower_priority()
    try:
        if prepare is not None:
            prepare()
    except Exception as error:
        with suppress(OSError):
            connection.send(_failure_message(error))
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
            answer = _failure_message(error)
        try:
            connection.send(answer)
        except OSError:
            return


def _failure_message(error: Exception) -> tuple[str, str]:
    return "failed", f"{type(error).__name__}: {error}"


Place = tuple[str, tuple[int, ...]]  # name and shape


class SharedPicture:
    """Room for one picture; it grows when pictures do."""

    def __init__(self) -> None:
        self._memory: SharedMemory | None = None

    def room(self, shape: tuple[int, ...]) -> Place:
        """Make room; name and shape, by which `picture_at` finds it."""
        size = math.prod(shape)
        if self._memory is None or self._memory.size < size:
            self.close()
            self._memory = SharedMemory(create=True, size=size)
        return self._memory.name, shape

    def put(self, image: Image) -> Place:
        """Put a picture there; name and shape, as for `room`."""
        place = self.room(image.shape)
        self._view(image.shape)[:] = image
        return place

    def copy(self, shape: tuple[int, ...]) -> Image:
        """Take a copy of the picture that somebody has put into the room."""
        return self._view(shape).copy()

    def _view(self, shape: tuple[int, ...]) -> Image:
        assert self._memory is not None  # room was made
        return np.ndarray(shape, dtype=np.uint8, buffer=self._memory.buf)

    def close(self) -> None:
        """Give the room back."""
        if self._memory is not None:
            self._memory.close()
            self._memory.unlink()
            self._memory = None


_attached: dict[str, SharedMemory] = {}  # in the other process: until the pictures grow
_MAX_ATTACHED = 4  # attached at once: two pictures, and their places before they grew


def location_of(image: Image) -> Place | None:
    """Say where a picture that `picture_at` gave stands; None for another one."""
    for name, memory in _attached.items():
        if memory.size >= image.nbytes and image.flags.c_contiguous:
            there = np.ndarray(image.shape, dtype=np.uint8, buffer=memory.buf)
            if there.ctypes.data == image.ctypes.data:
                return name, image.shape
    return None


def picture_at(name: str, shape: tuple[int, ...]) -> Image:
    """Look at a picture that another process has put there; it holds until the next one."""
    if name not in _attached:
        while len(_attached) >= _MAX_ATTACHED:
            _attached.pop(next(iter(_attached))).close()
        _attached[name] = SharedMemory(name=name)
    return np.ndarray(shape, dtype=np.uint8, buffer=_attached[name].buf)
