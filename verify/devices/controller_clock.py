"""A controller's clock, unwrapped; a reset or a jump starts a new segment of it."""

from dataclasses import dataclass

JUMP = 0.1  # s: no line in the field is early; by more than this the clock itself has leapt ahead
LATE = 1.0  # s: an older reading is of no use, and may be of a clock that was set back unseen
DRIFT = 2e-4  # a crystal is within 1e-4; so fast may the floor rise
CONFIRM = 5  # readings in a row that contradict the clock before it is taken for a new one
STALE = "not later than the one before"
AHEAD = "time stamp ahead of the clock"
TOO_LATE = "too late to be of use"


@dataclass(frozen=True, slots=True)
class Instant:
    """A time on a controller's clock."""

    t: float  # s
    segment: int


class ControllerClock:
    """Follows the time stamps of a controller.

    A message is never there before it was sent, so host time less controller time has a floor. A
    stamp that steps below the floor, lies far above it, or is not later than the last, is refused;
    if it was no accident but the clock that leapt, the following ones say the same, and a segment
    begins. A lump that a paused line delivers late catches up in small steps, and is over before
    any of this is believed.

    Args:
        wraps_after: s, where a counter starts over; None if it does not.
        in_lumps: messages come late and together as a rule: only their order is looked at.
    """

    def __init__(self, wraps_after: float | None, *, in_lumps: bool = False) -> None:
        self._wrap, self._in_lumps = wraps_after, in_lumps
        self._segment = -1
        self._last_raw = self._last = self._last_host = 0.0
        self._floor = float("inf")
        self._anew = True
        self._against, self._against_since = 0, 0.0

    def restart(self, wraps_after: float | None) -> None:
        """Take the next stamp as the first of a new segment: the device was reset, or lost."""
        self._anew, self._wrap = True, wraps_after

    def stamp(self, raw: float, t_host: float) -> Instant | str:
        """Place a time stamp.

        Args:
            raw: s, as the controller sent it.
            t_host: s, when it was in hand.

        Returns:
            Where it stands on the clock, or why it is not used.
        """
        if self._anew:
            return self._begin(raw, t_host)
        step = self._step(raw, t_host)
        refusal = self._refusal(step, t_host)
        if not refusal:
            return self._accept(raw, self._last + step, t_host)
        return self._begin(raw, t_host) if self._confirmed(refusal, t_host) else refusal

    def _begin(self, raw: float, t_host: float) -> Instant:
        self._segment += 1
        self._anew, self._floor, self._last_host = False, float("inf"), t_host
        return self._accept(raw, raw, t_host)

    def _accept(self, raw: float, t: float, t_host: float) -> Instant:
        risen = self._floor + DRIFT * (t_host - self._last_host)
        self._floor = min(risen, t_host - t)
        self._last_raw, self._last, self._last_host = raw, t, t_host
        self._against = 0
        return Instant(t, self._segment)

    def _step(self, raw: float, t_host: float) -> float:
        """Time since the last stamp; after a long silence a counter may have wrapped often."""
        step = raw - self._last_raw
        if self._wrap is None:
            return step
        step %= self._wrap
        turns = round((t_host - self._last_host - step) / self._wrap)
        return step + max(turns, 0) * self._wrap

    def _refusal(self, step: float, t_host: float) -> str:
        if step <= 0.0:
            return STALE
        if self._in_lumps:
            return ""
        elapsed = t_host - self._last_host
        above = t_host - (self._last + step) - self._floor
        if above < -JUMP and step > elapsed + JUMP:
            back = self._wrap is not None and self._wrap - step < self._wrap / 2
            return STALE if back else AHEAD
        return TOO_LATE if above > LATE + DRIFT * elapsed else ""

    def _confirmed(self, refusal: str, t_host: float) -> bool:
        if self._against == 0:
            self._against_since = t_host
        self._against += 1
        lump_is_over = refusal != TOO_LATE or t_host - self._against_since > LATE
        return self._against >= CONFIRM and lump_is_over
