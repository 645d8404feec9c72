"""What was measured in a session, through its pictures or by another instrument, and its clock."""

from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

import robots
from verify.caveats import rig_moved
from verify.clock import ClockEstimate, estimate_clock
from verify.errors import InputError
from verify.instrument import noise_of, see_poses
from verify.instrument_scatter import scattered
from verify.measurement import Setup
from verify.preview import draw_pair
from verify.readings import Readings
from verify.records import Array, Measurement, StereoPair
from verify.session import Instrument, Session
from verify.systematics import Systematics, sensitivities, stated
from verify.track import Track, collect

SEARCH_SPAN = 2.0  # s about a pair, for readings whose clock is not known yet
SEARCH_STEP = 0.05  # s: arms turn a degree or two in it, branches and LEDs lie further apart
MOST_CANDIDATES = 200

Progress = Callable[[int, int], None]
Chain = Callable[[Iterable[StereoPair], Setup], Iterator[Measurement]]


@dataclass(frozen=True, slots=True)
class Seen:
    """What the pictures, or the instrument, gave."""

    measurements: list[Measurement]
    track: Track
    systematics: Systematics
    preview: bytes | None  # of a pair; an instrument's poses have none


def setup_of(session: Session) -> Setup:
    """What the chain needs to know to measure a session."""
    readings = Readings(session.encoders.t, session.encoders.q)
    return Setup(session.rig, session.marker, _expectation(session, readings))


def see_pictures(session: Session, progress: Progress, chain: Chain) -> Seen:
    """Stream the pictures through the chain; only numbers are kept.

    Args:
        session: with pictures.
        progress: called with pairs done and pairs in all.
        chain: what measures the pairs.
    """
    setup = setup_of(session)
    turning = bool(np.ptp(session.frames.pan_left) or np.ptp(session.frames.pan_right))
    systematics = stated(session.rig, session.marker, turning)
    measurements: list[Measurement] = []
    effects: list[Array] = []
    recent: deque[StereoPair] = deque(maxlen=2)
    preview: bytes | None = None
    for m in chain(_watched(session.pairs(), recent), setup):
        measurements.append(m)
        if m.status == "measured":
            effects.append(sensitivities(systematics, m, session.rig, session.marker))
            if preview is None and m.frame >= len(session) // 2:
                pair = next((p for p in recent if p.frame == m.frame), None)
                preview = draw_pair(pair, m, session.marker) if pair is not None else None
        progress(len(measurements), len(session))
    return Seen(measurements, collect(measurements, session.rig, effects), systematics, preview)


def see_instrument(
    session: Session, instrument: Instrument, readings: Readings
) -> tuple[Seen, ClockEstimate]:
    """Take an instrument's poses; noise that it does not state is sought in the data.

    Args:
        session: whose robot was measured.
        instrument: the session's.
        readings: the robot's own.

    Returns:
        The poses, and the readings' clock.
    """
    noise = noise_of(instrument)
    seen = see_poses(session, instrument, readings, noise)
    clock = clock_of(session, seen.track, readings)
    found = None
    if not noise.known:
        found = scattered(session, instrument, seen.track, readings, clock.offset)
    if found is not None:
        seen = see_poses(session, instrument, readings, found, clock.offset)
        if not instrument.positions_alone:  # places and turns now weigh as much as they are worth
            clock = clock_of(session, seen.track, readings)
    return Seen(seen.measurements, seen.track, seen.systematics, None), clock


def _watched(pairs: Iterator[StereoPair], recent: deque[StereoPair]) -> Iterator[StereoPair]:
    for pair in pairs:
        recent.append(pair)
        yield pair


def _expectation(session: Session, readings: Readings) -> Callable[[float], Sequence[Array]]:
    """Where the readings put the flange in the rig at a time; many places with an open clock."""
    offset = 0.0 if session.clock is None else session.clock.encoder_offset
    around = np.arange(-SEARCH_SPAN, SEARCH_SPAN + SEARCH_STEP, SEARCH_STEP)
    every = np.linspace(readings.t[0], readings.t[-1], MOST_CANDIDATES)

    def expected(t: float) -> Sequence[Array]:
        if session.clock is not None:
            times = np.array([t - offset])
        else:
            times = t + around
            times = times[(times >= readings.t[0]) & (times <= readings.t[-1])]
            times = times if len(times) else every
        poses = session.rig.rig_T_base @ robots.forward(session.arm, readings.at(times))
        return list(poses)

    return expected


def nothing_measured(session: Session, seen: Seen) -> InputError:
    """Say why a session gave no pose, as far as its pairs tell."""
    measurements = seen.measurements
    counts = Counter(m.status for m in measurements)
    most = max((m.leds_seen for m in measurements), default=0)
    said = ", ".join(f"{n} {status}" for status, n in sorted(counts.items())) or "no pairs"
    return InputError(
        session.folder,
        f"no pair could be measured ({said}; at most {most} LEDs recognised in one pair)",
        f"{len(session.marker)} LEDs are asked for by marker.toml",
        rig_moved(session, measurements, seen.systematics)
        or "Check that the LEDs are lit and in view, and that rig.toml and marker.toml belong to "
        "this recording.",
    )


def clock_of(session: Session, track: Track, readings: Readings) -> ClockEstimate:
    """Take the clock that session.toml gives, or find it from the motion."""
    if session.clock is None:
        return estimate_clock(track, session.arm, readings)
    given = session.clock
    return ClockEstimate(
        given.encoder_offset, given.standard_uncertainty, "given", np.zeros((0, 2))
    )
