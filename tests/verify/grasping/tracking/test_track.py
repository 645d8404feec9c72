"""From simulated pictures to a 3D track: accuracy, and what happens when it gets hard.

One thing must never happen: `tracked`, and somewhere else.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.bench.tracking import SCENARIOS, drawn_around
from tests.support.grasp.caps import BLUE, GREEN, RED, Cap, Slab, pairs, small_rig, still
from tests.support.scene import project
from verify.core.records import Array, StereoPair
from verify.errors import InputError
from verify.grasping.tracking.target import (
    BoxSelection,
    ColourSelection,
    Target,
    TargetObservation,
    TrackingOptions,
)
from verify.grasping.tracking.track import track

RIG = small_rig()
RADIUS = 0.02
HERE = (0.0, 0.02, 0.7)


def tracked(
    things: Sequence[Cap | Slab], seconds: float, target: Target, **scene: Any
) -> list[TargetObservation]:
    return list(track(pairs(things, RIG, seconds, **scene), RIG, target))


def drawn(place: Sequence[float]) -> BoxSelection:
    x, y = project(RIG.left, RIG.left.pan, np.array(place)[None])[0]
    return BoxSelection((round(x) - 16, round(y) - 16, 32, 32))


def errors(seen: list[TargetObservation], target: Cap) -> Array:
    """Distance from the truth in each pair that says `tracked`, m."""
    sure = [s for s in seen if s.status == "tracked"]
    return np.array([np.linalg.norm(s.centre - np.array(target.path(s.t))) for s in sure])


def spans(seen: list[TargetObservation]) -> list[str]:
    """The statuses in order, each once in a row."""
    words = [s.status for s in seen]
    return [w for i, w in enumerate(words) if i == 0 or words[i - 1] != w]


def test_a_cap_at_rest_is_found_by_its_colour_and_measured() -> None:
    cap = Cap(BLUE, still(*HERE))
    seen = tracked([cap, Cap(GREEN, still(0.1, 0.05, 0.75))], 0.7, ColourSelection("blue"))
    assert spans(seen) == ["searching", "tracked"]
    last = seen[-1]
    off = last.centre - np.array(HERE)
    assert np.linalg.norm(off) < 0.002
    assert off @ np.linalg.solve(last.covariance, off) < 11.3  # chi² of 3 at 1 %
    assert np.sqrt(last.covariance[2, 2]) < 0.004
    assert np.linalg.norm(last.velocity) < 0.01
    assert last.size[0] == pytest.approx(2 * RADIUS, abs=2.5 * last.size_standard_uncertainty[0])
    assert last.quality > 0.8
    assert last.epipolar < 3.0
    assert last.left is not None
    assert last.windows[0] is not None


def test_a_moving_cap_is_followed_though_the_cameras_are_not_in_step() -> None:
    cap = Cap(GREEN, lambda t: (0.1 * np.sin(4 * t), 0.02, 0.7 + 0.04 * np.cos(4 * t)))
    seen = tracked([cap], 2.0, ColourSelection("green"))
    assert spans(seen) == ["searching", "tracked"]
    away = errors(seen, cap)
    assert np.sqrt(np.mean(away**2)) < 0.003
    squares = [
        (off := s.centre - np.array(cap.path(s.t))) @ np.linalg.solve(s.covariance, off)
        for s in seen[10:]
    ]
    assert np.mean(squares) < 4.0  # 3 where covariance and error agree
    velocity = np.array([0.4 * np.cos(4 * seen[-1].t), 0.0, -0.16 * np.sin(4 * seen[-1].t)])
    np.testing.assert_allclose(seen[-1].velocity, velocity, atol=0.1)


def test_a_hidden_target_is_lost_and_found_again() -> None:
    cap = Cap(BLUE, still(*HERE))
    board = Slab(lambda t: (-0.25 + 0.35 * t, 0.0, 0.5), width=0.08)
    seen = tracked([cap, board], 2.2, drawn(HERE))
    words = spans(seen)
    assert words[0] == words[-1] == "tracked"
    assert "lost" in words
    assert errors(seen, cap).max() < 0.008
    hidden = [s for s in seen if s.status == "lost"]
    assert np.isfinite(hidden[0].centre).all()  # predicted for a while …
    late = [s for s in hidden if s.t - hidden[0].t > TrackingOptions().coast]
    assert all(np.isnan(s.centre).all() for s in late)  # … and not for ever
    assert hidden[0].reason


def test_a_target_half_hidden_in_one_camera_is_not_lost() -> None:
    """As between the fingers: whole for the one camera, four tenths of it for the other."""
    cap = Cap(BLUE, still(*HERE))

    def path(t: float) -> tuple[float, float, float]:
        return (0.09 - 0.044 * float(np.interp(t, [0.4, 0.9, 1.9, 2.4], [0, 1, 1, 0])), 0.0, 0.45)

    finger = Slab(path, width=0.03)
    seen = tracked([cap, finger], 2.6, drawn(HERE))
    assert spans(seen) == ["tracked", "occluded", "tracked"]
    parts = [s.right.area / s.left.area for s in seen if s.left and s.right]
    assert min(parts) < 1 / 1.8  # patches as unequal are two things where nothing is known
    assert errors(seen, cap)[-5:].max() < 0.008  # the first whole sight still carries the parts'
    for one in seen:
        off = one.centre - np.array(HERE)
        assert off @ np.linalg.solve(one.covariance, off) < 11.3  # chi² of 3 at 1 %


@pytest.mark.parametrize("seed", [56, 126])
def test_a_track_that_lags_catches_up(seed: int) -> None:
    """Where a target turns back, the track was once left centimetres behind its own pictures."""
    scene = SCENARIOS["carried, the light halves"](np.random.default_rng(seed))
    rig, target = small_rig(), scene.things[0]
    film = list(pairs(scene.things, rig, scene.seconds, light=scene.light, seed=seed))
    selection = drawn_around(target, rig, film[0])
    seen = list(track(film, rig, selection, TrackingOptions()))
    assert errors(seen, target).max() < 0.0095


@pytest.mark.parametrize("gap", [-0.08, 0.08], ids=["before it", "behind it"])
def test_another_of_its_colour_that_passes_is_not_followed(gap: float) -> None:
    cap = Cap(BLUE, still(*HERE))
    other = Cap(BLUE, lambda t: (-0.22 + 0.22 * t, 0.02 - 0.15 * gap, 0.7 + gap))
    seen = tracked([cap, other], 2.4, drawn(HERE))
    assert errors(seen, cap).max() < 0.008
    assert spans(seen)[0] == spans(seen)[-1] == "tracked"


def test_a_target_that_passes_another_of_its_colour_goes_on_as_itself() -> None:
    cap = Cap(RED, lambda t: (-0.18 + 0.2 * t, 0.02, 0.72))
    other = Cap(RED, still(0.03, 0.035, 0.63))
    seen = tracked([cap, other], 2.2, drawn(cap.path(0.0) or HERE))
    assert errors(seen, cap).max() < 0.01
    assert spans(seen)[-1] == "tracked"


def test_another_of_its_colour_is_not_taken_for_a_target_that_has_left() -> None:
    def path(t: float) -> tuple[float, float, float]:
        return (0.15 + 0.7 * max(min(t - 0.3, 1.5 - t), 0.0), 0.02, 0.7)  # 0.57 m and back

    cap, other = Cap(BLUE, path), Cap(BLUE, still(-0.1, 0.05, 0.72))
    seen = tracked([cap, other], 2.0, drawn(path(0.0)))
    assert spans(seen)[0] == spans(seen)[-1] == "tracked"
    assert any("has left the" in s.reason for s in seen)
    assert errors(seen, cap).max() < 0.025  # at its return nobody knows yet how fast it goes
    assert errors(seen[:20] + seen[-15:], cap).max() < 0.01


def test_two_of_the_colour_are_refused_until_one_is_selected() -> None:
    caps = [Cap(BLUE, still(-0.06, 0.02, 0.7)), Cap(BLUE, still(0.06, 0.02, 0.7))]
    seen = tracked(caps, 0.5, ColourSelection("blue"))
    assert {s.status for s in seen} == {"searching"}
    assert seen[-1].reason == "2 objects have this colour: select one"
    chosen = tracked(caps, 0.3, drawn((0.06, 0.02, 0.7)))
    assert errors(chosen, caps[1]).max() < 0.003


def test_a_missing_colour_is_reported() -> None:
    seen = tracked([Cap(GREEN, still(*HERE))], 0.2, ColourSelection("blue"))
    assert {(s.status, s.reason) for s in seen} == {("searching", "its colour is not seen")}
    assert np.isnan(seen[-1].centre).all()
    assert seen[-1].quality == 0.0


def test_drifting_colours_are_followed_on_request_only() -> None:
    def film() -> Iterator[StereoPair]:
        for i in range(60):  # six seconds from blue halfway to purple: another lamp
            b, g, r = (
                round(a + i / 120 * (z - a)) for a, z in zip(BLUE, (170, 40, 130), strict=True)
            )
            pair = next(pairs([Cap((b, g, r), still(*HERE))], RIG, 1 / 30, seed=i))
            yield replace(pair, frame=i, t_left=i / 10, t_right=i / 10)

    pictures = list(film())
    adapting = list(track(pictures, RIG, drawn(HERE), TrackingOptions(adaptation=1.0)))
    fixed = list(track(pictures, RIG, drawn(HERE)))
    assert adapting[-1].status == "tracked"
    assert fixed[-1].status == "lost"


def test_grey_pictures_are_refused() -> None:
    pair = next(pairs([], RIG, 0.1))
    grey = StereoPair(0, 0.0, 0.0, 0.0, 0.0, pair.left[..., 0], pair.right[..., 0])
    with pytest.raises(InputError, match="are grey; a target is identified by its colour"):
        next(track([grey], RIG, ColourSelection("blue")))
