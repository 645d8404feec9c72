"""The whole chain a pair against decoding that pair: what measuring adds to reading the video.

Decoding and the chain take turns within the same run, and medians are compared: the ratios carry
over to another machine, the milliseconds do not.
"""

import tempfile
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np

from verify.core.records import StereoPair
from verify.io.files import write_folder_whole
from verify.io.session.session import Session, open_session
from verify.measurement.chain import Setup, measure
from verify.simulation import library
from verify.simulation.session.folder import write_session
from verify.simulation.session.simulate import simulate_session

SAMPLE = Path(__file__).parents[2] / "sample_sessions" / "multi_joint_fault_6r"
PAIRS = 40  # of each session, after the first, which is searched whole
ROUNDS = 5


def lines() -> Iterator[str]:
    """Compare on a sample, whose background is black, and on one with a room behind the arm."""
    yield from _session("sample session", open_session(SAMPLE))
    with tempfile.TemporaryDirectory() as place:
        look = {"black_level_dn": 6.0, "background_dn": 14.0, "texture_dn": 4.0}
        folder = noisy_sample(Path(place) / "room", PAIRS + 1, **look)
        yield from _session("session with a room behind the arm", open_session(folder))


def noisy_sample(folder: Path, pairs: int, **look: float) -> Path:
    """Simulate the sample for so many pairs with noise in every pixel, as a real camera gives."""
    sample = library.load(SAMPLE.name)
    image = msgspec.structs.replace(sample.image, **look)
    recording = msgspec.structs.replace(sample.recording, pairs=pairs)
    scenario = msgspec.structs.replace(sample, image=image, recording=recording)
    with write_folder_whole(folder) as partial:
        write_session(simulate_session(scenario), partial)
    return folder


def _session(name: str, session: Session) -> Iterator[str]:
    setup = Setup(session.rig, session.marker)
    decoding, measuring = [], []
    for _ in range(ROUNDS):
        decoding.append(_decode(session))
        measuring.append(_measure(list(islice(session.pairs(), PAIRS + 1)), setup))
    decode, chain = float(np.median(decoding)), float(np.median(measuring))
    yield (
        f"{name}: the chain takes {chain / decode:.2f} times as long as decoding the pair "
        f"({chain * 1e3:.1f} and {decode * 1e3:.1f} ms)"
    )


def _decode(session: Session) -> float:
    """Read and decode one pair, s, as a stream; the first waits for the file to be opened."""
    pairs = session.pairs()
    next(pairs)
    start = time.perf_counter()
    count = sum(1 for _ in islice(pairs, PAIRS))
    spent = time.perf_counter() - start
    pairs.close()
    return spent / count


def _measure(pairs: list[StereoPair], setup: Setup) -> float:
    """Measure one pair that is already in memory, s; the first pair comes with the second."""
    chain = measure(iter(pairs), setup)
    next(chain)
    start = time.perf_counter()
    count = sum(1 for _ in chain)
    return (time.perf_counter() - start) / count
