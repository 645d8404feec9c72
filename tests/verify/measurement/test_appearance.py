"""LEDs that have become smaller or dimmer than when they were last seen."""

from dataclasses import replace

import msgspec
import numpy as np
from numpy.testing import assert_allclose

from robots.transforms import difference
from tests.bench.coverage import before_a_room
from tests.support.simulated import in_memory, marker_of, rendered, scene
from verify.core.records import Array
from verify.measurement.alignment import RawSightings
from verify.measurement.appearance import WIDTH_FADING, Appearance
from verify.measurement.chain import Setup, measure
from verify.simulation.scenario import Occlusion, ScenarioRecording

SIGMA = 0.02  # px
CENTRES = np.array([[100.0, 200.0], [300.0, 220.0], [200.0, 400.0]])


def seen(width: list[float], right: list[float] | None = None) -> RawSightings:
    """LEDs of these widths in the left picture, and in the right one the same or others."""
    widths = (width, width if right is None else right)
    n = len(width)
    return RawSightings(
        led=np.array([*range(n), *range(len(widths[1]))], dtype=np.int64),
        centre=np.concatenate([CENTRES[: len(own)] for own in widths]),
        covariance=np.tile(SIGMA**2 * np.eye(2), (n + len(widths[1]), 1, 1)),
        peak=np.full(n + len(widths[1]), 180.0),
        taken=np.zeros(n + len(widths[1])),
        depth=np.full(n + len(widths[1]), 0.6),
        width=np.concatenate(widths),
        merged=np.zeros(n + len(widths[1]), np.bool_),
        left=n,
        instants=(0.0, 0.0),
        pans=(0.0, 0.0),
    )


def after(*pairs: RawSightings) -> Appearance:
    appearance = Appearance.unknown(3)
    for raw in pairs:
        appearance = appearance.after(raw)
    return appearance


def added(appearance: Appearance, raw: RawSightings) -> Array:
    """Standard deviation that is added along either axis, (n, 2), px, in the left picture."""
    widened = appearance.widen_hidden(raw).covariance
    return np.sqrt(np.diagonal(widened, axis1=1, axis2=2) - SIGMA**2)[: raw.left]


def test_an_led_that_alone_has_become_smaller_is_as_uncertain_as_its_width_has_lost() -> None:
    """A disc of 5 px behind an edge that hides 2 px: its middle is 1 px off, its mean width 4."""
    appearance = after(seen([5.0, 5.0, 5.2]))
    assert_allclose(added(appearance, seen([4.0, 5.1, 5.2])), [[1, 1], [0, 0], [0, 0]], atol=0.1)
    alike = seen([4.8, 5.0, 5.0])
    assert appearance.widen_hidden(alike) is alike
    # in one picture alone: the other one's are left alone
    left, right = np.split(
        appearance.widen_hidden(seen([4.0, 5.1, 5.2], [5.0, 5, 5])).covariance, 2
    )
    assert left[0, 0, 0] > 0.9
    assert np.array_equal(right, alike.covariance[3:])


def test_leds_that_all_become_smaller_are_whole() -> None:
    """An arm that comes to rest, and leaves no trails any more."""
    assert_allclose(added(after(seen([6.0, 7.0, 8.0])), seen([4.5, 5.2, 6.0])), 0.0)


def merged(leds: list[bool], raw: RawSightings) -> RawSightings:
    """The same, some of them merged, in either picture."""
    return replace(raw, merged=np.array(leds * 2))


def test_what_is_not_known_or_merged_is_left_alone() -> None:
    first = merged([True, False, False], seen([4.0, 5.0, 5.0]))
    assert_allclose(added(Appearance.unknown(3), first), 0.0)
    assert_allclose(added(after(seen([5.0, 5.0, 5.0])), first), 0.0)
    assert_allclose(added(after(seen([5.0, 5.0, 5.0])), seen([])), np.empty((0, 2)))
    wider = merged([True, False, False], seen([9.0, 9.0, 5.0]))
    assert_allclose(after(seen([5.0] * 3), wider).width[0], [5.0 * WIDTH_FADING, 9.0, 5.0])


def test_a_hidden_led_is_remembered_as_it_was() -> None:
    hidden = [seen([3.6, 5.0, 5.0])] * 6
    appearance = after(seen([5.0, 5.0, 5.0]), *hidden)
    assert added(appearance, hidden[0])[0, 0] > 0.9
    assert_allclose(appearance.least_peaks, [54.0, 54.0])


def test_a_merged_led_that_kept_its_width_shows_that_others_have_not() -> None:
    raw = merged([False, False, True], seen([4.0, 3.8, 5.2]))
    assert_allclose(
        added(after(seen([5.0, 5.0, 5.2])), raw), [[1, 1], [1.2, 1.2], [0, 0]], atol=0.1
    )


def test_poses_from_half_leds_before_texture_are_as_uncertain_as_they_say() -> None:
    """LEDs of 4 px: half of one looks like a narrower one, and texture hides the difference."""
    marker = msgspec.structs.replace(marker_of("ABC"), led_diameter_mm=2.6)
    for seed in (1, 2):
        hides = [
            Occlusion(led="ABC"[k % 3], first=f, last=f + 5, camera="left", share=0.5)
            for k, f in enumerate(range(4, 50, 8))
        ]
        recording = ScenarioRecording(pairs=54, rate_hz=20.0)
        plain = in_memory(scene(marker=marker, recording=recording, occlusion=hides, seed=seed))
        session = before_a_room(plain, "6 px, 15 DN").simulated
        truth = session.world.rig_T_flange(session.t[:, 0])
        chi2 = [
            off @ np.linalg.solve(m.pose.covariance, off) / 6
            for m in measure(rendered(session), Setup(session.rig, session.marker))
            if m.pose is not None
            for off in [difference(m.pose.rig_T_flange, truth[m.frame])]
        ]
        assert len(chi2) > 50
        assert np.sqrt(max(chi2)) < 4
