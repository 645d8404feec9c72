"""One long session measured in parts by several workers, to the same last digit as in one go.

The chain is a function of the pair and of what it carries from the pair before. A part starts a few
pairs early with nothing carried; soon it looks in the same windows and carries the same bits as
the chain that comes from the beginning. Where the two meet, what they carry is compared bit by bit:
if it is equal, so is all that follows. If not, the part before goes on until it is.
"""

import hashlib
import pickle
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np

from verify.analysis import setup_of
from verify.measurement import Carried, Setup, measure
from verify.records import Image, Measurement, StereoPair
from verify.series import Frames
from verify.session import Session
from verify.video import Images, NumberedImages, open_images

PART = 300  # pairs: long enough that the early start costs little
EARLY = 24  # pairs: after 4 to 17 a part carries the bits that the chain from the beginning does
NO_IMAGE: Image = np.zeros((0, 0), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class Span:
    """Pairs `first` to `last` - 1 of a session."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class Part:
    """What came of a span."""

    span: Span
    outcomes: dict[int, list[Measurement]]  # told after pair n was asked for, before the next
    carried: dict[int, bytes]  # before pair n: a hash of what was carried into it
    at_the_end: bytes  # what is carried out of the last pair, as a pickle
    shown: StereoPair | None  # the first measured pair of the session's second half, if it is here


def spans(pairs: int) -> list[Span]:
    """Cut a session into parts of equal length; a short one stays whole."""
    count = max(pairs // PART, 1)
    cuts = [pairs * i // count for i in range(count + 1)]
    return [Span(a, b) for a, b in pairwise(cuts)]


def measure_part(session: Session, span: Span) -> Part:
    """Measure the pairs of a span, beginning a few pairs early.

    Raises:
        InputError: a picture cannot be decoded.
    """
    start = max(span.first - EARLY, 0)
    with pairs_of(session, Span(start, span.last)) as pairs:
        return _followed(pairs, session, span, Carried())


def joined(session: Session, parts: list[Part]) -> tuple[list[Measurement], StereoPair | None]:
    """Put parts together, so that each measurement is the one that a single pass would give.

    Args:
        session: the whole.
        parts: all of its parts, in order.

    Returns:
        Its measurements, and the pair that the report shows.
    """
    outcomes: dict[int, list[Measurement]] = dict(parts[0].outcomes)
    shown = [parts[0].shown]
    true = parts[0]  # its end is as in a single pass
    for part in parts[1:]:
        if true.carried[part.span.first] == part.carried[part.span.first]:
            outcomes |= part.outcomes
            shown.append(part.shown)
            true = part
            continue
        true = _gone_on(session, true, part)
        outcomes |= true.outcomes
        shown.append(true.shown)
    every = [m for number in sorted(outcomes) for m in outcomes[number]]
    return every, next((pair for pair in shown if pair is not None), None)


@dataclass(frozen=True)
class Measured(Session):
    """A session whose pairs have been measured: what is left is to analyse it."""

    measurements: tuple[Measurement, ...]
    shown: StereoPair | None

    def pairs(self) -> Iterator[StereoPair]:  # type: ignore[override]  # nothing to close
        """Give every pair, without pictures but for the one that is shown."""
        for measurement in self.measurements:
            if self.shown is not None and self.shown.frame == measurement.frame:
                yield self.shown
            else:
                t = measurement.t
                yield StereoPair(measurement.frame, t, t, 0.0, 0.0, NO_IMAGE, NO_IMAGE)

    def chain(self, pairs: Iterable[StereoPair], _setup: Setup) -> Iterator[Measurement]:
        """Stand in for `measure`."""
        for _, measurement in zip(pairs, self.measurements, strict=True):
            yield measurement


def measured_session(
    session: Session, measurements: list[Measurement], shown: StereoPair | None
) -> Measured:
    """Take a session together with what came of its pairs."""
    facts = {field.name: getattr(session, field.name) for field in fields(Session)}
    return Measured(**facts, measurements=tuple(measurements), shown=shown)


def _gone_on(session: Session, true: Part, part: Part) -> Part:
    """Go on from the end of the part before, until what is carried is what `part` carries."""
    with pairs_of(session, part.span) as pairs:
        carried: Carried = pickle.loads(true.at_the_end)  # our own, moments old
        fresh = _followed(pairs, session, part.span, carried, until=part.carried)
    met = [n for n in fresh.carried if fresh.carried[n] == part.carried[n]]
    if not met:
        return fresh
    kept = {n: told for n, told in part.outcomes.items() if n >= met[0]}
    same = {n: code for n, code in part.carried.items() if n >= met[0]}
    before = fresh.shown is not None and fresh.shown.frame < met[0]
    return replace(
        part,
        outcomes=fresh.outcomes | kept,
        carried=fresh.carried | same,
        shown=fresh.shown if before else part.shown,
    )


def _followed(
    pairs: Iterable[StereoPair],
    session: Session,
    span: Span,
    carried: Carried,
    until: dict[int, bytes] | None = None,
) -> Part:
    """Run the chain, and write down what it carries into each pair of the span."""
    told: dict[int, list[Measurement]] = {}
    codes: dict[int, bytes] = {}
    recent: dict[int, StereoPair] = {}
    at, end = [span.first - 1], [b""]

    def watched() -> Iterator[StereoPair]:
        for pair in pairs:
            note(pair.frame)
            if until is not None and codes.get(pair.frame) == until[pair.frame]:
                return
            recent[pair.frame] = pair
            recent.pop(pair.frame - 2, None)
            yield pair
        note(span.last)

    def note(number: int) -> None:
        at[0] = number
        if number >= span.first:
            end[0] = pickle.dumps(carried)
            codes[number] = hashlib.sha256(end[0]).digest()

    shown = None
    for measurement in measure(watched(), setup_of(session), carried):
        late = measurement.frame >= len(session) // 2
        if at[0] < span.first or (at[0] == span.last and span.last < len(session)):
            continue  # of an early pair, or one that has yet to see its successor
        told.setdefault(at[0], []).append(measurement)
        if shown is None and late and measurement.status == "measured":
            shown = recent.get(measurement.frame)
    return Part(span, told, codes, end[0], shown)


@contextmanager
def pairs_of(session: Session, span: Span) -> Iterator[Iterator[StereoPair]]:
    """Stream the pairs of a span; what lies before it is not decoded where that can be helped."""
    with tempfile.TemporaryDirectory(prefix="verify-part-") as place:
        sides = [
            _cut(images, Path(place) / side, span)
            for side, images in (("left", session.left), ("right", session.right))
        ]
        left, right = sides
        if left is None or right is None:
            yield islice(session.pairs(), span.first, span.last)
            return
        frames = session.frames
        columns = (frames.t_left, frames.t_right, frames.pan_left, frames.pan_right)
        some = Frames(*(column[span.first : span.last] for column in columns))
        part = replace(session, left=left, right=right, frames=some)
        stream = part.pairs()
        try:
            yield (replace(pair, frame=pair.frame + span.first) for pair in stream)
        finally:
            stream.close()


def _cut(images: Images, place: Path, span: Span) -> Images | None:
    """Have a span's pictures apart, as they were encoded; None where they lean on others."""
    if isinstance(images, NumberedImages):
        place.mkdir()
        for number in range(span.first, span.last):
            own = images.path / f"{number:06d}.png"
            (place / f"{number - span.first:06d}.png").symlink_to(own.resolve())
        return open_images(place)
    import av  # a fifth of a second, and few sessions are so long

    target = place.with_suffix(".mkv")
    with av.open(str(images.path.resolve())) as source:
        stream = source.streams.video[0]
        with av.open(str(target), "w", format="matroska") as sink:
            copied = sink.add_stream_from_template(stream)
            packets = (packet for packet in source.demux(stream) if packet.size)
            for packet in islice(packets, span.first, span.last):
                if not packet.is_keyframe:
                    return None
                packet.stream = copied
                sink.mux(packet)
    return open_images(target)
