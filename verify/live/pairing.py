"""Pair the pictures of two free-running cameras by time."""

from collections import Counter, deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from verify.devices.protocols import CameraFrame

DEFAULT_PERIOD = 1 / 30  # s, until the cameras have shown their own
N_INTERVALS = 31  # of each camera, whose median is its period
# of a period: with half of it every picture has its partner, whatever the cameras' phase
MAX_TIME_DIFFERENCE = 0.5
TOL_JITTER = 0.1  # of a period: time stamps jitter
MAX_WAITING = 8  # pictures of a side that wait for their partner; the other camera may be stalled

NO_PARTNER = "no partner in time"
NOT_LATER = "not later than the previous picture"
OTHER_CAMERA_STALLED = "the other camera gives no pictures"


@dataclass(frozen=True, slots=True)
class FramePair:
    """Two pictures of about one instant, left and right."""

    left: CameraFrame
    right: CameraFrame
    arrived: float  # s, host's monotonic clock, when the later one was in hand


class Pairing:
    """Finds each picture's partner: the nearest in time, not further than half a period.

    A partner within half a period cannot be beaten by a picture that is still to come, so nothing
    waits for longer than its own partner takes. Pictures of a pair rise strictly in time on either
    side. The period, s, is the slower camera's; None has it found from the pictures.
    """

    def __init__(self, period: float | None = None) -> None:
        self._given = period
        self._waiting: tuple[deque[CameraFrame], deque[CameraFrame]] = (deque(), deque())
        self._times: tuple[deque[float], ...] = tuple(deque(maxlen=N_INTERVALS) for _ in range(2))
        self.dropped: Counter[str] = Counter()

    def waiting(self, side: int) -> int:
        """Count the pictures of a side that wait for their partner."""
        return len(self._waiting[side])

    @property
    def period(self) -> float:
        """Time between two pictures of the slower camera, s."""
        if self._given is not None:
            return self._given
        # plain numbers: both cameras wait for it
        periods = [
            median(later - earlier for earlier, later in pairwise(times))
            for times in self._times
            if len(times) > 2
        ]
        return max(periods) if len(periods) == 2 else DEFAULT_PERIOD

    def add(self, side: int, frame: CameraFrame, arrived: float) -> FramePair | None:
        """Take a picture of the left (0) or right (1) camera, arrived now (s, host's monotonic).

        Returns the pair that it completes, if it does.
        """
        times = self._times[side]
        if times and frame.t <= times[-1]:
            self.dropped[NOT_LATER] += 1
            return None
        times.append(frame.t)
        partner = self._partner(self._waiting[1 - side], frame)
        if partner is None:
            queue = self._waiting[side]
            queue.append(frame)
            if len(queue) > MAX_WAITING:
                queue.popleft()
                self.dropped[OTHER_CAMERA_STALLED] += 1
            return None
        if own := self._waiting[side]:
            self.dropped[NO_PARTNER] += len(own)
            own.clear()
        left, right = (frame, partner) if side == 0 else (partner, frame)
        return FramePair(left, right, arrived)

    def _partner(self, others: "deque[CameraFrame]", frame: CameraFrame) -> CameraFrame | None:
        """Take the nearest waiting picture of the other side; older ones have missed theirs."""
        tolerance = (MAX_TIME_DIFFERENCE + TOL_JITTER) * self.period
        while others and others[0].t < frame.t - tolerance:
            others.popleft()
            self.dropped[NO_PARTNER] += 1
        near = [other for other in others if abs(other.t - frame.t) <= tolerance]
        if not near:
            return None
        best = min(near, key=lambda other: abs(other.t - frame.t))
        while others.popleft() is not best:
            self.dropped[NO_PARTNER] += 1
        return best
