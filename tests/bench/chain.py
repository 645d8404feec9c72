"""The whole chain a pair against decoding that pair: what measuring adds to reading the video.

Decoding and the chain take turns within the same run, and medians of processor time are compared,
all threads together, as of one core: the ratios carry over to another machine, the milliseconds do
not.
"""

import gc
import shutil
import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import cv2
import msgspec
import numpy as np

from tests.bench.detection import UNIT_MS, cluttered_frame, simple_centres
from tests.bench.goals import Figure
from verify.core.readings import Readings
from verify.core.records import StereoPair
from verify.io.encoding import VideoWriter
from verify.io.files import write_folder_whole
from verify.io.session.session import Session, open_session
from verify.live.clock import LiveClock
from verify.live.joint_row import Comparer
from verify.measurement.chain import Setup, measure
from verify.simulation import library
from verify.simulation.session.folder import write_session
from verify.simulation.session.simulate import simulate_session

SAMPLE = Path(__file__).parents[2] / "sample_sessions" / "multi_joint_fault_6r"
PAIRS = 40  # of each session, after the first, which is searched whole
ROUNDS = 5
GOAL_FFV1, GOAL_MJPEG = 1.10, 1.25  # the chain over decoding
GOAL_PAIR_MS = 1.0  # from a decoded pair to joint errors
QUALITY = 90  # of JPEGs, as webcams give them


def lines() -> Iterator[Figure]:
    """Compare on a sample, whose background is black, as FFV1 and as JPEGs; and with a room."""
    sample = open_session(SAMPLE)
    yield from _session("FFV1", sample, GOAL_FFV1)
    yield from _joint_errors(sample)
    with tempfile.TemporaryDirectory() as place:
        jpegs = open_session(_as_jpegs(sample, Path(place) / "jpegs"))
        yield from _session("MJPEG", jpegs, GOAL_MJPEG)
        look = {"black_level_dn": 6.0, "background_dn": 14.0, "texture_dn": 4.0}
        folder = noisy_sample(Path(place) / "room", PAIRS + 1, **look)
        yield from _session("FFV1 with a room behind the arm", open_session(folder))


def _as_jpegs(session: Session, folder: Path) -> Path:
    """Copy the sample with its pictures as the JPEGs that a webcam would give."""
    shutil.copytree(SAMPLE, folder)
    size = session.rig.image_size
    left, right = VideoWriter(folder / "left.mkv", 30.0), VideoWriter(folder / "right.mkv", 30.0)
    with left, right:
        for pair in session.pairs():
            for video, picture in ((left, pair.left), (right, pair.right)):
                done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
                assert done
                video.add_jpeg(data.tobytes(), size)
    return folder


def noisy_sample(folder: Path, pairs: int, **look: float) -> Path:
    """Simulate the sample for so many pairs with noise in every pixel, as a real camera gives."""
    sample = library.load(SAMPLE.name)
    image = msgspec.structs.replace(sample.image, **look)
    recording = msgspec.structs.replace(sample.recording, pairs=pairs)
    scenario = msgspec.structs.replace(sample, image=image, recording=recording)
    with write_folder_whole(folder) as partial:
        write_session(simulate_session(scenario), partial)
    return folder


def _session(name: str, session: Session, goal: float | None = None) -> Iterator[Figure]:
    setup = Setup(session.rig, session.marker)
    decoding, measuring = [], []
    for _ in range(ROUNDS):
        decoding.append(_decode(session))
        measuring.append(_measure(list(islice(session.pairs(), PAIRS + 1)), setup))
    decode, chain = float(np.median(decoding)), float(np.median(measuring))
    note = f"{chain * 1e3:.1f} and {decode * 1e3:.1f} ms"
    yield Figure(f"analysis / decoding, {name}", chain / decode, most=goal, note=note)


def _joint_errors(session: Session) -> Iterator[Figure]:
    """From decoded pictures to joint errors with covariance.

    Of a recording all pairs are compared at once. Live each one is by itself: from its pictures to
    its errors by the pairs before it, and with what settles the one before it, which is done while
    the next one is waited for. Beside them the simple way to the spots alone of one picture.
    """
    setup, clock = Setup(session.rig, session.marker), LiveClock(0.0, 1e-4, "given")
    comparer = Comparer(session.arm, session.rig, session.marker, None, turning=False)
    readings = Readings(session.encoders.t, session.encoders.q)
    pairs = list(islice(session.pairs(), PAIRS + 1))
    frame = cluttered_frame(np.random.default_rng(1))

    def recorded() -> float:
        measured = measure(iter(pairs), setup)
        next(measured)
        start = time.process_time()
        rows = comparer.rows([(m, clock) for m in measured], readings, np.zeros(PAIRS))
        assert all(row.status == "measured" for row in rows)
        return (time.process_time() - start) / len(rows)

    def live() -> tuple[float, float]:
        measured = measure(iter(pairs), setup, causal=True)
        next(measured)
        rows, until, first = [], 0.0, time.process_time()
        start = first
        for one in measured:  # a pair, and then the one before it, settled by both its neighbours
            if not one.settled:
                rows += comparer.rows([(one, clock)], readings, np.zeros(1))
                until += time.process_time() - start
            start = time.process_time()
        assert all(row.status == "measured" for row in rows)
        return until / len(rows), (start - first) / len(rows)

    def simple() -> float:
        start = time.process_time()
        for _ in pairs:
            simple_centres(frame)
        return (time.process_time() - start) / len(pairs)

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    gc.collect()
    gc.freeze()  # as a watch does
    spent = np.median([(recorded(), *live(), simple()) for _ in range(ROUNDS)], axis=0).tolist()
    gc.unfreeze()
    cv2.setNumThreads(threads)
    unit, name = spent.pop(), "decoded pair to joint errors with covariance, tracked"
    ways = "recorded", "live", "live, and the pair before it settled"
    for way, taken in zip(ways, spent, strict=True):
        yield Figure(f"{name}, {way}", 1e3 * taken, "ms", most=GOAL_PAIR_MS)
        beside, note = f"{name}, {way}, over threshold + contours + moments", f"{1e3 * unit:.2f} ms"
        yield Figure(beside, taken / unit, most=GOAL_PAIR_MS / UNIT_MS, note=note)


def _decode(session: Session) -> float:
    """Read and decode one pair, s, as a stream; the first waits for the file to be opened."""
    pairs = session.pairs()
    next(pairs)
    start = time.process_time()
    count = sum(1 for _ in islice(pairs, PAIRS))
    spent = time.process_time() - start
    pairs.close()
    return spent / count


def _measure(pairs: list[StereoPair], setup: Setup) -> float:
    """Measure one pair that is already in memory, s; the first pair comes with the second."""
    chain = measure(iter(pairs), setup)
    next(chain)
    start = time.process_time()
    count = sum(1 for _ in chain)
    return (time.process_time() - start) / count
