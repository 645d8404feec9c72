"""LEDs that are elsewhere than marker.toml says are named, and nobody is where all is as stated.

LEDs by OpenCV; rig and marker are drawn about what is stated.
"""

from dataclasses import replace

import numpy as np
import pytest

from robots.transforms import difference
from tests.bench.diagnosis.sessions import measured, watched
from tests.support.drawn_rig import believed, drawn
from tests.support.moved_rig import seen_by, turned
from verify.analysis.rig_check.leds import PictureMisfit, misfit_warning, picture_misfit
from verify.core.fiducials import Marker
from verify.core.records import Array, Measurement
from verify.core.rig import Camera, Rig
from verify.measurement.systematics import stated_systematics

PAIRS = 40
FILE = believed(doubts=True)
World = tuple[Rig, Marker]


def world(seed: int) -> World:
    return drawn(*FILE, np.random.default_rng([seed, 1]))


def with_led_moved(true: World, led: int, by_mm: list[float]) -> World:
    leds = true[1].leds.copy()
    leds[led] += np.array(by_mm) * 1e-3
    return true[0], replace(true[1], leds=leds)


def seen(true: World, seed: int, file: World = FILE) -> list[Measurement]:
    return seen_by(true, file, seed, PAIRS)


def misfit_of(measurements: list[Measurement], file: World = FILE) -> PictureMisfit:
    found = picture_misfit(measurements, *file, stated_systematics(*file, turning=False))
    assert found is not None
    return found


def warned(found: PictureMisfit) -> str:
    return misfit_warning(found, told=False) or ""


def test_where_all_is_as_stated_nobody_is_accused() -> None:
    found = [misfit_of(seen(world(seed), seed)) for seed in range(20)]
    assert [warned(one) for one in found] == [""] * 20
    # 400 degrees of freedom each: of the mean of twenty, 5 % are three standard deviations
    assert np.mean([one.whole for one in found]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("led", range(4))
@pytest.mark.parametrize("by_mm", [[0.0, 0.5, 0.0], [2.0, -1.0, 2.0]], ids=["0.5 mm", "3 mm"])
def test_a_displaced_led_is_named_with_how_far(led: int, by_mm: list[float]) -> None:
    found = misfit_of(seen(with_led_moved(world(led), led, by_mm), led))
    assert found.led is not None
    assert found.led.name == "ABCD"[led]
    off = found.led.displacement - np.array(by_mm) * 1e-3
    assert np.linalg.norm(off) < 5 * found.led.standard_uncertainty + 5e-5  # the drawn places
    assert found.led.standard_uncertainty < 1e-4
    assert warned(found).startswith(f"LED {found.led.name} is seen ")
    assert "in the last pairs" not in warned(found)


def test_an_led_that_is_moved_while_recording_is_named_as_that() -> None:
    true, late = world(1), with_led_moved(world(1), 2, [0.0, 0.0, 3.0])
    half = PAIRS // 2
    found = misfit_of([*seen(true, 1)[:half], *seen(late, 2)[half:]])
    assert found.led is not None
    assert (found.led.name, found.led.end) == ("C", np.inf)
    assert found.led.begin == pytest.approx(5.0 * half - 2.5)  # a pair every 5 s
    assert np.linalg.norm(found.led.displacement) == pytest.approx(3e-3, abs=1e-4)
    assert "from its place in marker.toml from t_left_s = 97.50 on" in warned(found)


def _focal_length(camera: Camera) -> Camera:
    scaled: Array = camera.matrix.copy()
    scaled[0, 0] *= 1.01
    return replace(camera, matrix=scaled)


CHANGES = {
    "focal length": lambda rig: replace(rig, left=_focal_length(rig.left)),
    "roll": lambda rig: replace(rig, right=turned(rig.right, 2, 1.0)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_of_another_rig_no_led_is_accused(change: str) -> None:
    rig, marker = world(3)
    found = misfit_of(seen((CHANGES[change](rig), marker), 3))
    assert found.led is None
    assert "times as far from where rig.toml and marker.toml put them" in warned(found)
    assert misfit_warning(found, told=True) is None


def test_a_few_pairs_with_a_reflection_are_no_contradiction() -> None:
    pairs = seen(world(4), 4)
    strange = seen(with_led_moved(world(4), 0, [15.0, 0.0, 0.0]), 4)
    assert warned(misfit_of([*pairs[:-2], *strange[-2:]])) == ""


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("axis", [0, 2])
def test_a_camera_that_is_tilted_while_recording_is_named_with_when_and_how_far(
    side: str, axis: int
) -> None:
    (rig, marker), half = world(7), PAIRS // 2
    tilted = replace(rig, **{side: turned(getattr(rig, side), axis, 0.1)})
    pairs = [*seen((rig, marker), 7)[:half], *seen((tilted, marker), 8)[half:]]
    found = misfit_of(pairs)
    assert found.contradicts
    assert found.led is None
    assert found.tilted is not None
    assert np.degrees(found.tilted.angle) == pytest.approx(0.1, rel=0.25)
    off = abs(found.tilted.angle - np.radians(0.1))
    assert off < 3 * found.tilted.standard_uncertainty
    assert found.tilted.begin == pytest.approx((pairs[half - 1].t + pairs[half].t) / 2)
    assert warned(found).startswith("A camera was tilted in the session, at t_left_s = 97.50: by 0")


def test_of_a_camera_that_turns_about_its_pan_axis_the_pictures_do_not_say_that_it_tilts() -> None:
    rig, marker = world(9)
    late = replace(rig, right=turned(rig.right, 1, 0.2)), marker
    pairs = [*seen((rig, marker), 9)[: PAIRS // 2], *seen(late, 10)[PAIRS // 2 :]]
    assert misfit_of(pairs).tilted is None


def test_nobody_is_said_to_have_tilted_a_camera_that_stood_or_is_late() -> None:
    assert [misfit_of(seen(world(seed), seed)).tilted for seed in range(20)] == [None] * 20
    case = watched(1)  # of a moving arm
    late = measured(case.session, case.systematics, case.noise, skew=0.004)
    found = picture_misfit(late, case.session.rig, case.session.marker, case.systematics)
    assert found is not None
    assert found.contradicts
    assert found.tilted is None


def test_right_pictures_that_are_late_are_no_tilt_where_they_look_like_one() -> None:
    """Of a motion whose late pictures a tilt would explain to nine tenths."""
    case = watched(200)
    late = list(measured(case.session, case.systematics, case.noise, skew=0.004))
    t, poses = np.array([m.t for m in late]), np.array([m.pose.rig_T_flange for m in late])
    twists = difference(poses[2:], poses[:-2]) / (t[2:] - t[:-2])[:, None]
    files = case.session.rig, case.session.marker, case.systematics
    moving = [
        replace(m, pose=replace(m.pose, twist=twist))
        for m, twist in zip(late[1:-1], twists, strict=True)
    ]
    still, told = (picture_misfit(some, *files) for some in (late, moving))
    assert still is not None
    assert still.tilted is not None  # of a body that is not known to move it would be one
    assert told is not None
    assert told.tilted is None


def test_of_leds_whose_places_have_no_uncertainty_only_what_no_jig_does_is_told() -> None:
    file = FILE[0], replace(FILE[1], led_standard_uncertainty=None)
    near, far = (
        misfit_of(seen(with_led_moved(world(5), 1, [0.0, by, 0.0]), 5, file), file)
        for by in (0.5, 3.0)
    )
    assert warned(near) == ""
    assert far.led is not None
    assert far.led.name == "B"


def test_too_few_pairs_or_leds_show_nothing() -> None:
    parameters = stated_systematics(*FILE, turning=False)
    pairs = seen(world(6), 6)
    assert picture_misfit(pairs[:9], *FILE, parameters) is None
    two = replace(FILE[1], names=("A", "B"), leds=FILE[1].leds[:2], colours=("white",) * 2)
    assert picture_misfit(pairs, FILE[0], two, parameters) is None
