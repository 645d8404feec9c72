"""Child processes, their priority, and pictures in memory that processes share.

A child process is started as a fresh interpreter, tells when it is ready, exchanges messages with
the process that started it, and ends with it. Nothing else in this program starts processes of
Python code.
"""

import faulthandler
import gc
import hashlib
import math
import multiprocessing
import os
import secrets
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

import numpy as np

from verify.core.records import Image

START_TIMEOUT = 60.0  # s until a child process is ready, or computes on
START_INTERVAL, START_SHARE = 1.0, 0.01  # s between such messages; of a processor, used meanwhile
JOIN_TIMEOUT = 1.0  # s for a child process to end by itself before it is terminated
# kinds of messages from a child process
STARTING, READY, FAILED, ANSWER = "starting", "ready", "failed", "answer"

Message = tuple[str, Any]  # kind and value
Request = TypeVar("Request")
Answer = TypeVar("Answer")


class ChildLostError(Exception):
    """The child process has ended, or its work failed; the text is the reason."""


class ChildLateError(ChildLostError):
    """No message came within the timeout."""


class ChildFailedError(ChildLostError):
    """The child process reports that its work failed."""


class ParentLostError(Exception):
    """The process that started this one has closed the line, or has ended."""


class ParentLine:
    """The line from a child process to its parent process."""

    def __init__(self, incoming: Connection, outgoing: Connection) -> None:
        self._incoming, self._outgoing = incoming, outgoing
        self._lock, self._started = threading.Lock(), False

    def send(self, kind: str, value: Any = None) -> None:
        """Send a message; raises ParentLostError."""
        try:
            with self._lock:
                self._started |= kind == READY
                self._outgoing.send((kind, value))
        except OSError as error:
            raise ParentLostError from error

    def report_start(self) -> None:
        """Until READY, say now and then that this process computes: not where it hangs."""
        used = time.process_time()
        with suppress(OSError):
            while True:
                time.sleep(START_INTERVAL)
                before, used = used, time.process_time()
                with self._lock:
                    if self._started:
                        return
                    if used - before > START_SHARE * START_INTERVAL:
                        self._outgoing.send((STARTING, None))

    def receive(self) -> Any:
        """Wait for what the parent process sends; raises ParentLostError."""
        try:
            return self._incoming.recv()
        except (OSError, EOFError) as error:
            raise ParentLostError from error


class ChildProcess(Generic[Request, Answer]):
    """A process of its own that ends when this one does.

    It calls the importable `target` with a `ParentLine` and the pickled `args`; READY is sent from
    there. `name` stands in a list of processes. With `background` its priority is lower than this
    process's. `nested`: it starts a process itself and must be stopped, or this process waits.
    """

    def __init__(
        self,
        target: Callable[..., None],
        *args: Any,
        name: str,
        background: bool = False,
        nested: bool = False,
    ) -> None:
        # not forked: threads and open cameras do not survive a fork
        context = multiprocessing.get_context("spawn")
        requests, self._outgoing = context.Pipe(duplex=False)
        self._incoming, messages = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_run,
            args=(target, (requests, messages), args, background),
            name=name,
            daemon=not nested,
        )
        with _interrupts_postponed():
            self._process.start()
        requests.close()
        messages.close()
        self._lock = threading.Lock()
        self._early: deque[Message] = deque()  # sent before READY
        self._ready: Message | None = None
        self._unanswered = False

    def wait_until_ready(self, timeout: float = START_TIMEOUT) -> Any:
        """Wait for READY, its value; ChildLostError: it ends, or hangs for `timeout` s."""
        while self._ready is None:
            message = self._receive(timeout)
            if message[0] == READY:
                self._ready = message
            elif message[0] != STARTING:
                self._early.append(message)
        return self._ready[1]

    def is_ready(self) -> bool:
        """Whether it is ready, without a wait; raises ChildLostError: it did not start."""
        with self._lock, suppress(ChildLateError):
            self.wait_until_ready(0.0)
        return self._ready is not None

    def send(self, message: Any) -> None:
        """Send what its `ParentLine.receive` returns; raises ChildLostError: it has ended."""
        try:
            self._outgoing.send(message)
        except (OSError, ValueError) as error:
            raise ChildLostError(str(error)) from error

    def receive(self, timeout: float | None) -> Message:
        """Wait for a message, once it is ready; without a timeout, s, until the process ends.

        Raises:
            ChildLateError: no message within the timeout.
            ChildFailedError: it reports a failure.
            ChildLostError: it has ended.
        """
        return self._early.popleft() if self._early else self._receive(timeout)

    def ask(self, request: Request, timeout: float) -> Answer:
        """Send a request to `answer_requests`, wait for its answer; timeout, s, once it is ready.

        Raises:
            ChildLateError: no answer within the timeout, or none yet to the request before.
            ChildLostError: the work failed, or the process has ended.
        """
        with self._lock:
            self.wait_until_ready()
            self.begin(request)
            return self.finish(timeout)

    def begin(self, request: Request) -> None:
        """Send a request; `finish` waits for its answer.

        Raises:
            ChildLateError: the request before, which timed out, is still being answered.
            ChildLostError: the process has ended.
        """
        if self._unanswered:
            self.finish(0.0)
        self.send(request)
        self._unanswered = True

    def answered(self) -> bool:
        """Whether `finish` returns at once; raises ChildLostError: it did not start."""
        return self.is_ready() and self._incoming.poll(0.0)

    def finish(self, timeout: float) -> Answer:
        """Wait for the answer to `begin`'s request.

        Raises:
            ChildLateError: none within the timeout, s.
            ChildLostError: the work failed, or the process has ended.
        """
        try:
            answer: Answer = self.receive(timeout)[1]
        except ChildFailedError:
            self._unanswered = False
            raise
        self._unanswered = False
        return answer

    def stop(self, timeout: float = JOIN_TIMEOUT) -> None:
        """Close the line; terminate it after `timeout` s. Last messages can still be received."""
        self._outgoing.close()
        self._process.join(timeout)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(timeout)

    def _receive(self, timeout: float | None) -> Message:
        try:
            if not self._incoming.poll(timeout):
                raise ChildLateError(f"no answer within {timeout:g} s")
            message: Message = self._incoming.recv()
        except (OSError, EOFError) as error:
            raise ChildLostError(str(error) or "the process has ended") from error
        if message[0] == FAILED:
            raise ChildFailedError(str(message[1]))
        return message


AnyChild = TypeVar("AnyChild", bound=ChildProcess[Any, Any])


def wait_for_any(children: Iterable[AnyChild]) -> list[AnyChild]:
    """Wait until child processes have sent a message or ended; return those that have."""
    lines: dict[object, AnyChild] = {child._incoming: child for child in children}
    return [lines[line] for line in wait(list(lines))]  # type: ignore[arg-type]


def answer_requests(
    line: ParentLine, function: Callable[[Any], Any], prepare: Callable[[], object] | None = None
) -> None:
    """Answer each request with `function(request)`: a target for `ChildProcess`.

    `function` is importable; request and answer are pickled. `prepare` is called before READY.
    """
    if prepare is not None:
        prepare()
    gc.freeze()  # the collector need not search what was imported: that takes a picture's time
    line.send(READY)
    while True:
        request = line.receive()
        try:
            answer = ANSWER, function(request)
        except Exception as error:
            answer = FAILED, _failure(error)
        line.send(*answer)


def _run(
    target: Callable[..., None],
    ends: tuple[Connection, Connection],
    args: tuple[Any, ...],
    background: bool,
) -> None:
    line = ParentLine(*ends)
    for name in ("SIGINT", "SIGHUP"):  # a terminal's signals are for the parent process
        if hasattr(signal, name):  # the second is not everywhere
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    faulthandler.enable()
    threading.Thread(target=_exit_with_parent, name="parent", daemon=True).start()
    threading.Thread(target=line.report_start, name="start", daemon=True).start()
    if background:
        lower_priority()
    with suppress(ParentLostError):
        try:
            target(line, *args)
        except ParentLostError:
            raise
        except Exception as error:
            line.send(FAILED, _failure(error))


def _exit_with_parent() -> NoReturn:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    time.sleep(JOIN_TIMEOUT)  # for what is removed on the way out
    os._exit(1)


@contextmanager
def _interrupts_postponed() -> Iterator[None]:
    """Postpone Ctrl-C for a moment; a child process that starts meanwhile never gets it."""
    resource_tracker.ensure_running()  # it starts a process too, and lets signals pass again
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    main, came = threading.current_thread() is threading.main_thread(), threading.Event()
    # another thread may take the signal
    before = signal.signal(signal.SIGINT, lambda *_: came.set()) if main else None
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if main:
            signal.signal(signal.SIGINT, before)
        if came.is_set():
            signal.raise_signal(signal.SIGINT)


def _failure(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


NICENESS = 10


def lower_priority() -> None:
    """Lower the priority of this thread and those it starts; on Linux alone.

    Elsewhere niceness belongs to the whole process.
    """
    if sys.platform == "linux":
        os.nice(NICENESS)
        with suppress(PermissionError):  # some sandboxes; niceness remains
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


Place = tuple[str, tuple[int, ...]]  # name and shape
_BLOCK = f"verify-{hashlib.sha256(socket.gethostname().encode()).hexdigest()[:4]}-"


def _new_block(size: int) -> SharedMemory:
    """Make a block that is named for this process, and remove what killed ones have left."""
    for left in Path("/dev/shm").glob(f"{_BLOCK}*"):  # on Linux; elsewhere none are listed
        if not Path("/proc", left.name.removeprefix(_BLOCK).partition("-")[0]).exists():
            with suppress(OSError):  # another user's
                left.unlink()
    return SharedMemory(f"{_BLOCK}{os.getpid()}-{secrets.token_hex(4)}", create=True, size=size)


class SharedPicture:
    """Room for one picture; it grows when pictures do."""

    def __init__(self) -> None:
        self._memory: SharedMemory | None = None

    def room(self, shape: tuple[int, ...]) -> Place:
        """Make room; name and shape, by which `picture_at` finds it."""
        size = math.prod(shape)
        if self._memory is None or self._memory.size < size:
            self.close()
            self._memory = _new_block(size)
        return self._memory.name, shape

    def put(self, image: Image) -> Place:
        """Put a picture there; name and shape, as for `room`."""
        place = self.room(image.shape)
        self._view(image.shape)[:] = image
        return place

    def copy(self, shape: tuple[int, ...]) -> Image:
        """Take a copy of the picture in the room."""
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
