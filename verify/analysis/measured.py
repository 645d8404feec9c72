"""Measure a session, through its pictures or by another instrument, and find its clock."""

from collections import Counter, deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence, Set
from dataclasses import replace
from pathlib import Path

import numpy as np

import robots
from verify.analysis.clock.estimate import (
    LEAST_OVERLAP,
    ClockEstimate,
    clock_from_arrival_times,
    estimate_clock,
)
from verify.analysis.clock.search import are_visits
from verify.analysis.instrument import (
    MeasuredSession,
    measure_poses,
    noise_from_scatter,
    repeated_poses,
    stated_noise,
)
from verify.analysis.results.picture import draw_pair
from verify.analysis.results.warnings import rig_moved
from verify.analysis.rig_check.leds import (
    LED_ADVICE,
    MIN_LEDS,
    LedShifts,
    displacement_text,
    led_shifts,
    picture_misfit,
    shifted_marker,
    shifts_text,
)
from verify.analysis.rig_check.tilt import TURN_NAMES, TiltedCamera
from verify.core.readings import MAX_GAP, Readings
from verify.core.records import Array, Measurement, Progress, StereoPair, no_progress, same_picture
from verify.errors import InputError
from verify.io.session.poses import Instrument
from verify.io.session.session import Session
from verify.measurement.chain import Setup
from verify.measurement.systematics import Systematics, sensitivities, stated_systematics
from verify.measurement.track import Track, collect_track

TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}  # a second
MIN_STEP_RATIO = 5.0  # from reading to reading, over that of the pairs: nobody logs so little
MAX_UNREAD_SHARE = 0.1  # of the pairs, before and after the readings
MIN_MOTION = np.deg2rad(0.3)  # of a joint, beyond which the clock's offset matters
SAME_PAN = np.deg2rad(0.1)  # a base that stands there is read anew, not turned
SEARCH_SPAN = 2.0  # s about a pair, for readings whose clock is not known yet
SEARCH_STEP = 0.05  # s: arms turn a degree or two in it, branches and LEDs lie further apart
MAX_CANDIDATES = 200
MAX_FRAMES_NAMED = 5
ROUGHLY_PLACED = 2e-4  # m, standard uncertainty of an LED's place: pictures show it better
PLACED_BY_HAND = 2e-3  # m, to find it from
MAX_PLACE_ROUNDS = 6
TOL_PLACE, MAX_SHIFT = 5e-5, 2e-2  # m, of one round
CAMERA_REPEATS = (
    "A camera repeats pictures where its exposure is longer than the time between pairs, or the "
    "line is too slow: expose shorter, or record fewer pairs a second."
)
INSTRUMENT_REPEATS = (
    "An instrument that has lost its target, or a log that is faster than it, repeats the last "
    "value: measure these poses again, or log its own instants."
)
Chain = Callable[[Iterable[StereoPair], Setup], Iterator[Measurement]]


def setup_of(session: Session) -> Setup:
    """What the chain needs to know to measure a session."""
    readings = Readings(session.encoders.t, session.encoders.q)
    return Setup(session.rig, session.marker, _expected_poses(session, readings))


def _turned(session: Session) -> bool:
    """The bases turn, or stand elsewhere than where rig.toml puts them."""
    rig, frames = session.rig, session.frames
    sides = (rig.left, frames.pan_left), (rig.right, frames.pan_right)
    return any(np.ptp(pan) or abs(pan[0] - camera.pan) > SAME_PAN for camera, pan in sides)


def measure_pictures(
    session: Session, progress: Progress, chain: Chain, left_out: Container[int] = ()
) -> MeasuredSession:
    """Stream a session's pictures through the chain; only numbers are kept.

    `progress` is called with pairs done and pairs in all; `left_out`: frames to pass over.
    """
    setup = setup_of(session)
    systematics = stated_systematics(session.rig, session.marker, _turned(session))
    measurements: list[Measurement] = []
    effects: list[Array] = []
    alike: list[int] = []
    recent: deque[StereoPair] = deque(maxlen=2)
    preview: bytes | None = None
    pairs = (pair for pair in session.pairs() if pair.frame not in left_out)
    for m in chain(_remember_pairs(pairs, recent, alike), setup):
        measurements.append(m)
        if m.status == "measured":
            effects.append(sensitivities(systematics, m, session.rig, session.marker))
            if preview is None and m.frame >= len(session) // 2:
                pair = next((p for p in recent if p.frame == m.frame), None)
                preview = draw_pair(pair, m, session.marker) if pair is not None else None
        progress(len(measurements), len(session))
    track = collect_track(measurements, session.rig, effects)
    pictures = picture_misfit(measurements, session.rig, session.marker, systematics)
    if pictures is not None and pictures.tilted is not None and len(track):
        track = _with_tilt(track, session, measurements, systematics, pictures.tilted)
    return MeasuredSession(
        measurements, track, systematics, preview, tuple(alike), pictures=pictures
    )


def without_repeats(
    session: Session, measured: MeasuredSession, readings: Readings, offset: float, chain: Chain
) -> MeasuredSession:
    """Measure again without pairs that show an earlier instant, if there are any.

    A picture that is an earlier one while the readings move, `offset` s on the cameras' clock, was
    not taken anew. Such pairs keep a row, unaligned: nobody knows their instant.
    """
    t = np.array([m.t for m in measured.measurements]) - offset
    known, q = readings.available(t), readings.at(t)
    moves = (np.abs(np.diff(q, axis=0)) > readings.resolved).any(axis=1)
    rows = np.flatnonzero(moves & known[1:] & known[:-1]) + 1
    moving = {measured.measurements[i].frame for i in rows}
    repeated = moving.intersection(measured.alike)
    if not repeated:
        return measured
    again = measure_pictures(session, no_progress, chain, repeated)
    lost = [
        replace(m, status="unaligned", pose=None, left=None, right=None, choice="")
        for m in measured.measurements
        if m.frame in repeated
    ]
    measurements = sorted([*again.measurements, *lost], key=lambda m: m.frame)
    return replace(
        again,
        measurements=measurements,
        repeated=frozenset(repeated),
        displaced=measured.displaced,
        shifts=measured.shifts,
    )


def _with_tilt(
    track: Track,
    session: Session,
    measurements: Sequence[Measurement],
    systematics: Systematics,
    tilted: TiltedCamera,
) -> Track:
    """The track, with what a camera that was tilted in the session may have done to each pose.

    If the right camera was, and if the left one was: that is not known, but how large it may be.
    """
    asked = replace(systematics, names=TURN_NAMES)
    used = [m for m in measurements if m.status == "measured" and m.pose is not None]
    columns = [sensitivities(asked, m, session.rig, session.marker)[:, :-2] for m in used]
    by_side = np.reshape(columns, (len(track), 6, 2, -1))
    return replace(track, tilt=np.einsum("nisa,sna->nis", by_side, tilted.at(track.t)))


def without_displaced_led(
    session: Session, measured: MeasuredSession, chain: Chain
) -> tuple[Session, MeasuredSession]:
    """Measure again without an LED that is not in its place, if the others agree with the files.

    What single pairs reject beside it differs from pair to pair, so poses jump. The session
    returned has the marker without it, and a warning.
    """
    found, marker = measured.pictures, session.marker
    if found is None or found.led is None or len(marker) <= MIN_LEDS:
        return session, measured
    fewer = replace(session, marker=marker.without(found.led.name))
    again = measure_pictures(fewer, no_progress, chain)
    others = again.pictures
    if others is None or not others.agrees or len(again.track) < len(measured.track):
        return session, measured
    warning = (
        f"{displacement_text(found.led)}. It is left out: all figures rest on the other LEDs, "
        f"which agree with the files; {LED_ADVICE}"
    )
    told = replace(fewer, warnings=(*session.warnings, warning))
    return told, replace(again, displaced=found.led)


def with_measured_places(
    session: Session, measured: MeasuredSession, chain: Chain
) -> tuple[Session, MeasuredSession]:
    """Measure again with LEDs that are not in their places where the pictures show them.

    Beside each other, that is. As a whole they stand as the file has them, as well as places tell
    that are so far off. The session returned has that marker, and a warning. As before where camera
    or rig may have moved instead, or where the pictures contradict such places too.
    """
    found, marker = measured.pictures, session.marker
    stated = marker.led_standard_uncertainty or 0.0
    half = len(session) / 2
    sound = found is not None and not found.contradicts and stated < ROUGHLY_PLACED
    sound &= len(measured.track) >= half  # pairs that fit no pose tell nothing of what is wrong
    tilted = found is not None and found.tilted is not None
    few = len(marker) < MIN_LEDS
    off = None if sound or tilted or few else _shown_shifts(session, chain)
    if off is None:
        return session, measured
    warnings = (*session.warnings, shifts_text(off, marker))
    told = replace(session, marker=shifted_marker(marker, off), warnings=warnings)
    again = measure_pictures(told, no_progress, chain)
    agrees = again.pictures is not None and again.pictures.agrees
    if off.is_scale or not agrees or len(again.track) < max(len(measured.track), half):
        return session, measured
    return told, replace(again, shifts=off)


def _shown_shifts(session: Session, chain: Chain) -> LedShifts | None:
    """Fit the LEDs' places and measure by them in turns; None where they do not settle."""
    marker = replace(session.marker, led_standard_uncertainty=None)
    systematics = stated_systematics(session.rig, marker, _turned(session))
    leds = marker.leds
    for _ in range(MAX_PLACE_ROUNDS):
        there = replace(marker, leds=leds, led_standard_uncertainty=PLACED_BY_HAND)
        seen = measure_pictures(replace(session, marker=there), no_progress, chain)
        found = led_shifts(seen.measurements, session.rig, there, systematics)
        if found is None or np.abs(found.shift).max() > MAX_SHIFT:
            return None
        leds = leds + found.shift
        if np.abs(found.shift).max() < TOL_PLACE:
            return replace(found, leds=leds, shift=leds - marker.leds)
    return None


def measure_instrument(
    session: Session, instrument: Instrument, readings: Readings
) -> tuple[MeasuredSession, ClockEstimate]:
    """Take an instrument's poses, and the readings' clock; noise not stated is sought in the data.

    Raises:
        InputError: the poses are of several targets.
    """
    if instrument.poses.target is not None:
        raise InputError(
            session.left.path,
            "has the column target",
            "one target is compared with the readings",
            "`verify identify` takes several; give one target a session here.",
        )
    noise = stated_noise(instrument)
    seen = measure_poses(session, instrument, readings, noise)
    clock = session_clock(session, seen.track, readings)
    if repeated := repeated_poses(session, instrument, readings, clock.offset):
        seen = measure_poses(session, instrument, readings, noise, clock.offset, repeated)
        clock = session_clock(session, seen.track, readings)
    if noise.known:
        return seen, clock
    found = noise_from_scatter(session, instrument, seen.track, readings, clock.offset)
    if found is not None:
        seen = measure_poses(session, instrument, readings, found, clock.offset, repeated)
        if not instrument.positions_alone:  # places and turns now weigh as much as they are worth
            clock = session_clock(session, seen.track, readings)
    return seen, clock


def _remember_pairs(
    pairs: Iterable[StereoPair], recent: deque[StereoPair], alike: list[int]
) -> Iterator[StereoPair]:
    """Pass pairs on, the last ones kept; frames with a picture of one of these are listed."""
    for pair in pairs:
        if any(_shares_picture(before, pair) for before in recent):  # or a buffer two pairs old
            alike.append(pair.frame)
        recent.append(pair)
        yield pair


def _shares_picture(before: StereoPair, pair: StereoPair) -> bool:
    """Whether a camera gave the same picture in both pairs."""
    both = (before.left, pair.left), (before.right, pair.right)
    return any(same_picture(one, other) and np.ptp(one) for one, other in both)  # shows anything


def _expected_poses(session: Session, readings: Readings) -> Callable[[float], Sequence[Array]]:
    """Where the readings put the flange in the rig at a time; many places with an open clock."""
    offset = 0.0 if session.clock is None else session.clock.encoder_offset
    around = np.arange(-SEARCH_SPAN, SEARCH_SPAN + SEARCH_STEP, SEARCH_STEP)
    every = np.linspace(readings.t[0], readings.t[-1], MAX_CANDIDATES)

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


def measurement_refusal(session: Session, seen: MeasuredSession) -> InputError:
    """Say why a session gave no pose, as far as its pairs tell."""
    measurements = seen.measurements
    counts = Counter(m.status for m in measurements)
    most = max((m.leds_seen for m in measurements), default=0)
    said = ", ".join(f"{n} {status}" for status, n in sorted(counts.items())) or "no pairs"
    return InputError(
        session.folder,
        f"no pair could be measured ({said}; at most {most} LEDs recognised in one pair)",
        f"{len(session.marker)} LEDs are listed in marker.toml",
        rig_moved(session, measurements, seen.systematics)
        or "Check that the LEDs are lit and in view, and that rig.toml and marker.toml belong to "
        "this recording.",
    )


def session_clock(session: Session, track: Track, readings: Readings) -> ClockEstimate:
    """Take the clock that session.toml gives, or find it from arrival times and the motion.

    Raises:
        InputError: the readings' times are in another unit; or the motion does not show an offset,
            and no pair has a reading without one, or too few to find it by while the arm moves.
    """
    refuse_time_unit(session.folder, track.t, readings.t)
    if session.clock is not None:
        given = session.clock
        return ClockEstimate(
            given.encoder_offset, given.standard_uncertainty, "given", np.zeros((0, 2))
        )
    t_host = session.encoders.t_host
    arrival = None if t_host is None else clock_from_arrival_times(session.encoders.t, t_host)
    clock = estimate_clock(track, session.arm, readings, arrival)
    covered = readings.available(track.t - clock.offset)
    if clock.source != "none" or covered.mean() >= LEAST_OVERLAP:
        return clock
    remedy = "State [clock] encoder_offset_s, or record t_host_s."
    if not covered.any():
        raise InputError(*_apart(session.folder, track.t, readings.t), remedy)
    if not are_visits(track.t) and np.ptp(readings.q, axis=0).max() > MIN_MOTION:
        raise InputError(
            session.folder / "encoders.csv",
            f"the readings cover {covered.sum()} of {len(track)} pairs, too few to find the offset "
            "of their clock by",
            f"readings for {LEAST_OVERLAP:.0%} of the pairs or more, or a known offset",
            f"Give the whole log. {remedy}",
        )
    return clock


def _apart(folder: Path, t: Array, reading_t: Array) -> tuple[Path, str, str]:
    """Say that the readings' times are not those of the pairs."""
    span = f"{reading_t[0]:g} s to {reading_t[-1]:g} s"
    found = f"t_s runs from {span} and fits the pairs ({t[0]:g} s to {t[-1]:g} s) nowhere"
    expected = "readings must cover the pairs, once [clock] encoder_offset_s is added"
    return folder / "encoders.csv", found, expected


def refuse_time_unit(folder: Path, t: Array, reading_t: Array) -> None:
    """Raise InputError where the times of readings (m,) or pairs (n,), s, are in another unit."""
    if min(len(t), len(reading_t)) < 2:
        return
    step = float(np.median(np.diff(reading_t)))
    coarse = step > max(MAX_GAP, MIN_STEP_RATIO * float(np.median(np.diff(t))))
    ratio = float(np.ptp(reading_t) / np.ptp(t))
    for unit, size in TIME_UNITS.items():
        for whose, longer in ("The times", ratio * coarse), ("The pairs' times", 1 / ratio):
            if 0.5 < longer / size < 2:
                remedy = f"{whose} look like {unit}: divide them by {size:.0f}."
                raise InputError(*_apart(folder, t, reading_t), remedy)


def with_shown_noise(session: Session, readings: Readings) -> Session:
    """The session with what only the log shows: its readings' step, and how its stamps scatter."""
    taken = "as the log shows; it is taken into account"
    if session.encoder_resolution is None and readings.step:
        warning = (
            f"encoders.csv: readings come in steps of {np.rad2deg(readings.step):.2g}°, {taken}. "
            "Record more digits, or state [encoder_readings] resolution_deg."
        )
        warnings = (*session.warnings, warning)
        session = replace(session, encoder_resolution=readings.step, warnings=warnings)
    for joint in np.flatnonzero(readings.roughness.any(axis=0)).tolist():
        rough = readings.roughness[:, joint]
        since, until = readings.t[np.flatnonzero(rough)[[0, -1]]].tolist()
        most, usual = np.rad2deg([rough.max(), readings.noise[joint]]).tolist()
        warning = (
            f"encoders.csv: readings of joint {joint + 1} scatter by {most:.2g}° between t_s = "
            f"{since:.2f} and {until:.2f}, elsewhere by {usual:.2g}°. Pairs there count for as "
            "much less, and the verdict rests on the others. Check its encoder."
        )
        session = replace(session, warnings=(*session.warnings, warning))
    noise = max(readings.time_noise, session.encoders.late)
    if session.encoder_time_standard_uncertainty is not None or not noise:
        return session
    warning = (
        f"encoders.csv: the times of the readings scatter by {1e3 * noise:.2g} ms (standard "
        f"uncertainty), {taken}. Record the controller's own time stamps."
    )
    told = readings.time_noise <= session.encoders.late  # of the rows that repeat
    warnings = session.warnings if told else (*session.warnings, warning)
    return replace(session, encoder_time_standard_uncertainty=noise, warnings=warnings)


def with_repeats_named(session: Session, repeated: Set[int]) -> Session:
    """The session, with a warning that pairs were left out that show an earlier instant."""
    named = ", ".join(map(str, sorted(repeated)[:MAX_FRAMES_NAMED]))
    more = f" and {len(repeated) - MAX_FRAMES_NAMED} more" * (len(repeated) > MAX_FRAMES_NAMED)
    whose, advice = "pairs have a picture of an earlier pair", CAMERA_REPEATS
    if session.instrument is not None:
        whose, advice = "poses repeat an earlier one", INSTRUMENT_REPEATS
    warning = (
        f"{len(repeated)} of {len(session)} {whose} while the readings move, and are left out: "
        f"frames {named}{more}. {advice}"
    )
    return replace(session, warnings=(*session.warnings, warning))


def with_gaps_named(session: Session, readings: Readings, silent: Array, count: int) -> Session:
    """The session, with a warning where many of `count` pairs, `silent` (s), have no reading.

    Any in gaps, and more than MAX_UNREAD_SHARE before the first reading or after the last one.
    """
    after, warnings = np.searchsorted(readings.t, silent), []
    inside = after[(after > 0) & (after < len(readings.t))]
    if len(after) - len(inside) > MAX_UNREAD_SHARE * count:
        warnings.append(
            f"encoders.csv: {len(after) - len(inside)} of {count} pairs lie before its first "
            "reading or after its last one, and are left out: nothing is said of their poses. Log "
            "as long as the pictures are taken."
        )
    if len(inside):
        longest, since = np.diff(readings.t)[inside - 1].max(), readings.t[inside.min() - 1]
        warnings.append(
            f"encoders.csv: {len(inside)} of {count} pairs have no reading and are left out: the "
            f"log has gaps of up to {longest:.2g} s while the arm moves, the first from t_s = "
            f"{since:.2f} on. Log without gaps."
        )
    return replace(session, warnings=(*session.warnings, *warnings))
