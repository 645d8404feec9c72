"""How cost grows: with the size of the pictures, the LEDs, a session's length, the workers.

Everything is measured within one run, values of one series in turn, and medians are taken: how one
value compares with the next carries over to another machine, the times do not. Times are processor
time, of which other programs on the machine take nothing; only the batch goes by the clock.

    python -m tests.bench growth
"""

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import msgspec

import reports
from tests.bench.batch import pairs_a_second
from tests.bench.chain import SAMPLE, noisy_sample
from tests.bench.goals import Figure
from tests.support.simulated import in_memory
from verify.analysis.session import analyse
from verify.io.session.session import open_session
from verify.measurement.chain import Setup, measure
from verify.simulation import library
from verify.simulation.scenario import Scenario, ScenarioCamera, ScenarioLed

PAIRS, ROUNDS = 10, 7
SHARES = (0.5, 1.0, 1.5, 2.0)  # of 1280 x 720 px, each side
LEDS = {  # mm: those of the sample, and two more
    "A": (60.0, 5.0, 20.0), "B": (-50.0, 36.0, 12.0), "C": (-20.0, -55.0, 28.0),
    "D": (26.0, 52.0, 36.0), "E": (44.0, -40.0, 8.0), "F": (-64.0, -12.0, 30.0),
}  # fmt: skip
LENGTHS, LONG_ROUNDS = (60, 180, 540), 3  # pairs
SESSIONS = 16  # of the batch
SIZE, COUNT, LENGTH, WORKERS = "image size [Mpx]", "LEDs", "pairs", "workers"


def lines() -> Iterator[Figure]:
    """One line a point of each curve."""
    yield from sizes()
    yield from leds()
    yield from lengths()
    yield from workers()


def sizes() -> Iterator[Figure]:
    """A pair of pictures to the pose, in memory, tracked."""
    scenarios = {share**2 * 1280 * 720 / 1e6: _scaled(share) for share in SHARES}
    yield from _measured("a pair to its pose", SIZE, scenarios)


def leds() -> Iterator[Figure]:
    """The same for more LEDs on the flange."""
    sample = library.load(SAMPLE.name)
    scenarios: dict[float, Scenario] = {}
    for count in range(3, len(LEDS) + 1):
        some = [ScenarioLed(name=n, position_mm=LEDS[n]) for n in list(LEDS)[:count]]
        marker = msgspec.structs.replace(sample.marker, led=some)
        scenarios[float(count)] = msgspec.structs.replace(sample, marker=marker)
    yield from _measured("a pair to its pose", COUNT, scenarios)


def lengths() -> Iterator[Figure]:
    """Sessions from the disk to results, and results to both reports."""
    _spent(SAMPLE)  # loads what they need
    with tempfile.TemporaryDirectory() as place:
        folders = {pairs: noisy_sample(Path(place) / str(pairs), pairs) for pairs in LENGTHS}
        rounds = [{n: _spent(folder) for n, folder in folders.items()} for _ in range(LONG_ROUNDS)]
    for part, name in enumerate(("session to results", "results to reports")):
        for pairs in LENGTHS:
            spent = median(one[pairs][part] for one in rounds)
            yield Figure(name, spent, "s", along=LENGTH, at=pairs)


def _spent(folder: Path) -> tuple[float, float]:
    """Processor seconds that a session takes to its results, and they to both reports."""
    begun = time.process_time()
    results = analyse(open_session(folder))
    measured = time.process_time()
    reports.render_html(results)
    reports.render_pdf(results)
    return measured - begun, time.process_time() - measured


def workers() -> Iterator[Figure]:
    """A batch of sessions on so many cores."""
    cores = sorted(os.sched_getaffinity(0))[:4]
    with tempfile.TemporaryDirectory() as place:
        lab = Path(place) / "lab"
        for number in range(SESSIONS):
            shutil.copytree(SAMPLE, lab / f"{number:02d}")
        for count in range(1, len(cores) + 1):
            rate = pairs_a_second(lab, Path(place) / f"out{count}", cores[:count])
            yield Figure("batch", rate, "pairs/s", along=WORKERS, at=count)


def _scaled(share: float) -> Scenario:
    """The sample with pictures of another size, of the same view."""
    sample = library.load(SAMPLE.name)

    def camera(of: ScenarioCamera) -> ScenarioCamera:
        fx, fy = of.focal_px
        x, y = of.principal_point_px
        return msgspec.structs.replace(
            of, focal_px=(share * fx, share * fy), principal_point_px=(share * x, share * y)
        )

    width, height = (round(share * side) for side in sample.rig.image_size)
    rig = msgspec.structs.replace(
        sample.rig, image_size=(width, height), left=camera(sample.rig.left),
        right=camera(sample.rig.right),
    )  # fmt: skip
    return msgspec.structs.replace(sample, rig=rig)


def _measured(name: str, along: str, scenarios: dict[float, Scenario]) -> Iterator[Figure]:
    sessions = {at: in_memory(_short(scenario)) for at, scenario in scenarios.items()}
    pictures = {at: list(session.pairs()) for at, session in sessions.items()}
    spent: dict[float, list[float]] = {at: [] for at in sessions}
    for _ in range(ROUNDS + 1):
        for at, session in sessions.items():
            begun = time.process_time()
            list(measure(iter(pictures[at]), Setup(session.rig, session.marker)))
            spent[at].append(time.process_time() - begun)
    for at, seconds in spent.items():
        ms = 1e3 * median(seconds[1:]) / (PAIRS + 1)  # the first loads what is compiled
        yield Figure(name, ms, "ms", along=along, at=at)


def _short(scenario: Scenario) -> Scenario:
    recording = msgspec.structs.replace(scenario.recording, pairs=PAIRS + 1)
    return msgspec.structs.replace(scenario, recording=recording)
