"""The picture of a pair with its LEDs marked; pictures that a camera repeats."""

from collections import deque
from collections.abc import Generator, Iterable
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
import pytest

from tests.support.simulated import HOME_DEG, InMemory, in_memory, sample, scene
from verify.analysis.measured import _remember_pairs, measure_pictures, without_repeats
from verify.analysis.results.picture import HEIGHT, RING_COLOUR, WIDTH, draw_pair
from verify.analysis.session import analyse
from verify.core.fiducials import Marker
from verify.core.readings import Readings
from verify.core.records import Array, Image, Measurement, Sighting, StereoPair, no_progress
from verify.measurement.chain import measure
from verify.simulation.scenario import MultiJoint, Scenario, ScenarioImage, ScenarioRecording

MARKER = Marker(("", ""), np.zeros((2, 3)), (None, None), 0.005)  # no name is written
WIDE = np.array([[300.0, 400.0], [1700.0, 700.0]])  # more than the report's picture has


def draw_left(image: Image, centres: Array) -> Array:
    n = len(centres)
    seen = Sighting(
        np.arange(n), centres, np.tile(np.eye(2), (n, 1, 1)), 0.0, 0.0,
        np.full(n, 200.0), np.zeros((n, 2)), np.zeros((n, 3)),
    )  # fmt: skip
    pair = StereoPair(0, 0.0, 0.0, 0.0, 0.0, image, image)
    png = draw_pair(pair, Measurement(0, 0.0, "measured", n, left=seen, right=seen), MARKER)
    both = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert both is not None
    assert both.shape == (HEIGHT, 2 * WIDTH, 3)
    return both[:, :WIDTH].astype(float)


@pytest.mark.parametrize("centres", [WIDE, np.array([[505.0, 500.0], [560.0, 530.0]])])
def test_rings_lie_about_their_leds_where_the_picture_is_reduced_or_enlarged(
    centres: Array,
) -> None:
    image = np.zeros((1080, 1920), np.uint8)
    for x, y in centres.astype(int):
        image[y - 1 : y + 2, x - 1 : x + 2] = 255
    view = draw_left(image, centres)
    light = view.min(axis=2) > 90  # a ring has 80 of blue and red
    ring = np.abs(view - RING_COLOUR).max(axis=2) < 30
    for half in np.split(np.arange(WIDTH), 2):
        y, x = np.nonzero(light[:, half])
        top, left = np.nonzero(ring[:, half])
        assert np.ptp(left) > np.ptp(x)
        assert (left.min() + left.max()) / 2 == pytest.approx(x.mean(), abs=1.0)
        assert (top.min() + top.max()) / 2 == pytest.approx(y.mean(), abs=1.0)


def test_a_picture_that_is_reduced_keeps_the_mean_of_what_is_finer_than_its_pixels() -> None:
    image = np.zeros((1080, 1920), np.uint8)
    image[:, ::3] = 240  # every third column
    inside = draw_left(image, WIDE)[10:40, 10:-10]
    assert inside.mean() == pytest.approx(80, abs=2)
    assert inside.std() < 40  # of single columns: 113


@dataclass(frozen=True)
class Repeating(InMemory):
    """A session of which the left camera, or both, repeat their pictures in some pairs."""

    repeats: tuple[int, ...] = ()
    both: bool = True

    def pairs(self) -> Generator[StereoPair]:
        """Render the pairs, and repeat."""
        before: StereoPair | None = None
        for taken in super().pairs():
            pair = taken
            if before is not None and pair.frame in self.repeats:
                right = before.right if self.both else pair.right
                pair = replace(pair, left=before.left, right=right)
            before = pair
            yield pair


def repeating(scenario: Scenario, repeats: Iterable[int], both: bool) -> Repeating:
    session = in_memory(scenario)
    parts = {f.name: getattr(session, f.name) for f in fields(InMemory)}
    return Repeating(**parts, repeats=tuple(repeats), both=both)


@pytest.mark.slow
@pytest.mark.parametrize("both", [True, False])
def test_pairs_in_which_a_camera_repeats_its_picture_are_left_out(both: bool) -> None:
    scenario, repeats = sample(pairs=40), (3, 11, 12, 25, 34)
    plain, result = (analyse(repeating(scenario, r, both)) for r in ((), repeats))
    assert not any("picture of an earlier pair" in w for w in plain.summary["warnings"])
    assert any("5 of 40 pairs have a picture" in w for w in result.summary["warnings"])
    assert result.summary["pairs"]["rejected"] == {"unaligned": 5}
    assert result.summary["pairs"]["repeated"] == 5
    assert result.tables["frames"]["status"][list(repeats)].eq("unaligned").all()
    (cause,) = result.summary["diagnosis"]
    (fault,) = scenario.fault
    assert (cause["joint"], cause["kind"]) == (fault.joint, "offset")
    for joint, healthy in zip(result.summary["joints"], plain.summary["joints"], strict=True):
        assert joint["expanded_uncertainty_deg"] < 1.3 * healthy["expanded_uncertainty_deg"]
        true = fault.offset_deg * (joint["joint"] == fault.joint)
        assert abs(joint["mean_error_deg"] - true) < 1.5 * joint["expanded_uncertainty_deg"]


def test_a_picture_out_of_a_buffer_two_pairs_old_is_found() -> None:
    session = in_memory(scene(recording=ScenarioRecording(pairs=8, rate_hz=10.0)))
    taken = list(session.pairs())
    pairs = [replace(taken[k], left=taken[k - 2 * (k == 5)].left) for k in range(8)]
    alike: list[int] = []
    assert len(list(_remember_pairs(pairs, deque(maxlen=2), alike))) == 8
    assert alike == [5]


def test_pictures_without_noise_are_alike_while_the_arm_stands_and_stay() -> None:
    still = MultiJoint(home_deg=HOME_DEG, amplitude_deg=[0.0] * 6)
    silent = ScenarioImage(read_noise_dn=0.0, electrons_per_dn=1e9)
    recording = ScenarioRecording(pairs=4, rate_hz=10.0)
    session = in_memory(scene(motion=still, recording=recording, image=silent))
    readings = Readings(session.encoders.t, session.encoders.q)
    measured = measure_pictures(session, no_progress, measure)
    assert measured.alike == (1, 2, 3)
    assert without_repeats(session, measured, readings, 0.0, measure) is measured
