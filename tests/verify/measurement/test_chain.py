"""The chain from rendered pixels to poses, against the simulator's truth and its own optics."""

from dataclasses import fields, is_dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from robots.transforms import difference
from tests.support.leds.truth import true_spots
from tests.support.simulated import HOME_DEG, in_memory, marker_of, rendered, scene
from tests.support.spot_level import SpotRun, facing_rig, picture, without_pictures
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement, Spots, StereoPair, take_rows
from verify.measurement import chain
from verify.measurement.chain import Setup, detect_in_turn, measure
from verify.simulation.scenario import (
    Distractor,
    Mirror,
    MultiJoint,
    Occlusion,
    Scenario,
    ScenarioCamera,
    ScenarioClock,
    ScenarioImage,
    ScenarioLed,
    ScenarioMarker,
    ScenarioRecording,
    ScenarioRig,
    Visits,
)
from verify.simulation.session.simulate import SimulatedSession, simulate_session
from verify.simulation.world.led_render import Light, render_light, visible_lights

FOUR, TWO = marker_of("ABCD"), marker_of("AB")
# A pedestal instead of a clamp: the bound then needs no account of pixels cut off at 0.
OPTICS = ScenarioImage(blur_px=0.8, read_noise_dn=1.5, electrons_per_dn=32.0, black_level_dn=8.0)

# The same lens on a smaller sensor: as good a test of a spot as any, and sooner done.
SMALL_CAMERA = ScenarioCamera(principal_point_px=(319.5, 239.5))
SMALL = ScenarioRig(image_size=(640, 480), left=SMALL_CAMERA, right=SMALL_CAMERA)


def played(**changes: object) -> tuple[SimulatedSession, list[Measurement]]:
    """Simulate a scene of four LEDs and measure it, without encoders."""
    return measured(scene(**{"marker": FOUR, **changes}))


def measured(scenario: Scenario) -> tuple[SimulatedSession, list[Measurement]]:
    session = simulate_session(scenario)
    return session, list(measure(rendered(session), Setup(session.rig, session.marker)))


def wrong(session: SimulatedSession, measurements: list[Measurement]) -> Array:
    """Measured pose less true one, (n, 6), of the measured pairs."""
    truth = session.world.rig_T_flange(session.t[:, 0])
    pairs = [(m.pose.rig_T_flange, truth[m.frame]) for m in measurements if m.pose is not None]
    return np.array([difference(*pair) for pair in pairs])


def whitened(errors: Array, covariances: list[Array]) -> Array:
    root = np.linalg.cholesky(np.array(covariances))
    return np.asarray(np.linalg.solve(root, errors[:, :, None])[:, :, 0])


def claimed(measurements: list[Measurement]) -> list[Array]:
    return [m.pose.covariance for m in measurements if m.pose is not None]


def pose_bound(index: int) -> Array:
    """Cramér-Rao bound of one of the many pairs' poses from the renderer's own light, (6, 6).

    A pixel's light s has the variance read² + s / electrons + 1/12. A spot is symmetric about its
    centre, so brightness, width and background take nothing from what is known of the centre.
    """
    information = np.zeros((6, 6))
    for side in range(2):
        by_pose = projection_jacobian(many()[0], side, index)
        known = centre_informations(side, index - index % 10)  # spots change little in ten pairs
        information += np.einsum("lpi,lpq,lqj->ij", by_pose, known, by_pose)
    return np.linalg.inv(information)


@cache
def centre_informations(side: int, index: int) -> Array:
    """What the pixels know of where each LED's spot is, (leds, 2, 2), px⁻²."""
    session = many()[0]
    t, pan = float(session.t[index, side]), float(session.true_pan[index, side])
    return np.array(
        [centre_information(light, OPTICS) for light in visible_lights(session.world, side, t, pan)]
    )


def centre_information(light: Light, image: ScenarioImage) -> Array:
    step = 0.05  # px; the profile is smooth over tenths
    (x0, y0), middle = render_light(light, image.blur_px)
    slopes = []
    for axis in np.eye(2):
        sides = []
        for sign in (1, -1):
            (x, y), patch = render_light(replace(light, path=light.path + sign * step * axis),
                                  image.blur_px)  # fmt: skip
            frame = np.zeros((middle.shape[0] + 4, middle.shape[1] + 4))
            frame[y - y0 + 2 :, x - x0 + 2 :][: patch.shape[0], : patch.shape[1]] = patch
            sides.append(frame)
        slopes.append((sides[0] - sides[1]).ravel() / (2 * step))
    light_there = np.pad(middle, 2).ravel()
    variance = image.read_noise_dn**2 + light_there / image.electrons_per_dn + 1 / 12
    slope = np.stack(slopes)
    return np.asarray((slope / variance) @ slope.T)


def projection_jacobian(session: SimulatedSession, side: int, index: int) -> Array:
    """d pixel / d pose of every LED by the simulator's own projection, (leds, 2, 6)."""
    camera = session.world.bench.cameras[side]
    pan = float(session.true_pan[index, side])
    pose = session.world.rig_T_flange(session.t[index : index + 1, 0])[0]
    step, columns = 1e-6, []
    for unit in np.eye(6):
        pixels = []
        for sign in (1, -1):
            turn = Rotation.from_rotvec(sign * step * unit[3:]).as_matrix()
            arms = session.world.bench.leds @ (turn @ pose[:3, :3]).T
            pixels.append(camera.project(arms + pose[:3, 3] + sign * step * unit[:3], pan))
        columns.append((pixels[0] - pixels[1]) / (2 * step))
    return np.stack(columns, axis=-1)


PAIRS = 200  # 1200 whitened coordinates: a mean square is known to 4.1 %


@cache
def many() -> tuple[SimulatedSession, list[Measurement]]:
    return played(
        motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[8.0, 6.0, 8.0, 12.0, 12.0, 20.0]),
        recording=ScenarioRecording(pairs=PAIRS, rate_hz=15.0),
        image=OPTICS,
        rig=SMALL,
    )


@pytest.mark.slow
def test_poses_scatter_at_most_a_tenth_above_the_cramer_rao_bound() -> None:
    session, measurements = many()
    assert [m.status for m in measurements] == ["measured"] * PAIRS
    bounds = [pose_bound(i) for i in range(PAIRS)]
    ratio = np.sqrt(np.mean(whitened(wrong(session, measurements), bounds) ** 2))
    assert 0.95 < ratio < 1.1  # below by chance alone: 0.95 is two and a half of its own errors


@pytest.mark.slow
def test_the_reported_covariance_is_the_observed_scatter_about_no_bias() -> None:
    session, measurements = many()
    scatter = whitened(wrong(session, measurements), claimed(measurements))
    assert np.mean(scatter**2) == pytest.approx(1.0, abs=0.1)
    # each direction by itself, from its weakest to its strongest: 9 % known, three times that
    assert np.mean(scatter**2, axis=0) == pytest.approx(np.ones(6), abs=0.28)
    assert np.abs(scatter.mean(axis=0)).max() < 3.5 / np.sqrt(PAIRS)


LAMPS = [
    Distractor(position_mm=(60.0, -60.0, 800.0)),
    Distractor(position_mm=(-150.0, 40.0, 900.0), velocity_mm_s=(40.0, -20.0, 0.0)),
]
MIRROR = Mirror(point_mm=(160.0, 0.0, 650.0), normal=(-1.0, 0.0, 0.0), reflectance=0.5)


def assert_sound(session: SimulatedSession, measurements: list[Measurement]) -> None:
    """Every sighting lies where its LED truly is, and the poses are as good as they say."""
    measured = [m for m in measurements if m.pose is not None]
    for m in measured:
        good = np.split(~m.pose.rejected, [len(m.left)])
        for side, sighting in enumerate((m.left, m.right)):
            truth = true_spots(session, side)[m.frame, sighting.led[good[side]]]
            off = np.abs(sighting.centre[good[side]] - truth)
            sigma = np.sqrt(np.diagonal(sighting.covariance[good[side]], axis1=1, axis2=2))
            # px, 50 from LED to LED; a half-hidden one is farther off, and says so
            assert np.all(off < np.maximum(0.3, 2 * sigma))
    whole = [m for m in measured if m.pose.known_dof == 6]
    scatter = whitened(wrong(session, whole), claimed(whole))
    assert np.sqrt(np.mean(scatter**2, axis=1)).max() < 2.2  # six coordinates: 1e-4 by chance


def test_hidden_and_dropped_leds_are_recognised_not_averaged_in() -> None:
    session, measurements = played(
        recording=ScenarioRecording(pairs=26, rate_hz=10.0, dropped=[22]),
        distractor=LAMPS,
        occlusion=[
            Occlusion(led="B", first=4, last=6, camera="left"),
            *(Occlusion(led=name, first=9, last=10) for name in "ABCD"),
            *(Occlusion(led=name, first=13, last=14) for name in "ACD"),
            Occlusion(led="C", first=17, last=19, camera="right", share=0.5),
        ],
    )
    at = {int(session.taken[m.frame]): m for m in measurements}
    assert sorted(at) == [*range(22), 23, 24, 25]
    lost = {number: m.status for number, m in at.items() if m.status != "measured"}
    assert lost == {9: "too_few_leds", 10: "too_few_leds"}
    assert_sound(session, measurements)
    for number in (4, 5, 6):  # seen by one camera, and counted
        assert at[number].leds_seen == 4
        assert (len(at[number].left), len(at[number].right)) == (3, 4)
    for number in (13, 14):  # one LED left: a position, no more
        assert (at[number].leds_seen, at[number].pose.known_dof) == (1, 3)


def test_lamps_and_reflections_are_not_taken_for_leds() -> None:
    session, measurements = played(
        recording=ScenarioRecording(pairs=12, rate_hz=10.0),
        distractor=LAMPS,
        mirror=[MIRROR],
        occlusion=[Occlusion(led="D", first=5, last=8)],
    )
    assert {m.status for m in measurements} == {"measured"}
    assert [m.leds_seen for m in measurements] == [4] * 5 + [3] * 4 + [4] * 3
    assert_sound(session, measurements)


def test_returning_leds_win_over_their_reflection() -> None:
    session, measurements = played(
        recording=ScenarioRecording(pairs=12, rate_hz=10.0),
        mirror=[MIRROR],
        occlusion=[Occlusion(led=name, first=4, last=5) for name in "ABCD"],
    )
    assert_sound(session, [m for m in measurements if m.frame not in (4, 5)])


def with_blobs(
    u_px: float,
    peak_dn: float,
    pair: StereoPair,
    left_windows: Array | None,
    right_windows: Array | None,
) -> tuple[Spots, Spots]:
    """Find the spots, and blobs of a room: 20 in a whole picture, twelve in a window, where their
    uncertainty is `u_px`."""
    rng, found = np.random.default_rng(pair.frame), []
    windows = left_windows, right_windows
    for spots, searched in zip(detect_in_turn(pair, *windows), windows, strict=True):
        whole = searched is None
        boxes = np.array([[0, 0, 1280, 720]]) if searched is None else searched
        boxes = np.repeat(boxes, 20 if whole else 12, axis=0)
        blobs = take_rows(spots, np.zeros(len(boxes), dtype=np.int64))
        blobs = replace(
            blobs,
            centre=rng.uniform(boxes[:, :2], boxes[:, 2:]),
            covariance=np.tile((6.0 if whole else u_px) ** 2 * np.eye(2), (len(boxes), 1, 1)),
            peak=np.full(len(boxes), peak_dn),
            diameter=np.full(len(boxes), 20.0),
        )
        both = {
            f.name: np.concatenate([getattr(spots, f.name), getattr(blobs, f.name)])
            for f in fields(spots)
            if f.name != "noise"
        }
        found.append(replace(spots, **both))
    return found[0], found[1]


@pytest.mark.parametrize(("u_px", "peak_dn"), [(2.5, 50.0), (0.5, 25.0)], ids=["vague", "dim"])
def test_an_led_that_one_camera_does_not_see_is_not_replaced_by_a_blob(
    u_px: float, peak_dn: float
) -> None:
    session = simulate_session(
        scene(
            marker=marker_of("ABC"),
            recording=ScenarioRecording(pairs=12, rate_hz=10.0),
            occlusion=[Occlusion(led="C", first=3, last=10, camera="left")],
        )
    )
    blobs = partial(with_blobs, u_px, peak_dn)
    setup = Setup(session.rig, session.marker, detect=blobs)
    measurements = list(measure(rendered(session), setup))
    assert [m.status for m in measurements] == ["measured"] * 12
    assert np.abs(wrong(session, measurements)[:, :3]).max() < 1e-3


def joint_columns(frames: pd.DataFrame) -> tuple[Array, Array]:
    """Measured joint angles and their standard uncertainties, (n, 6) deg."""
    columns = [[f"q{j}_{kind}_deg" for j in range(1, 7)] for kind in ("measured", "u")]
    return frames[columns[0]].to_numpy(), frames[columns[1]].to_numpy()


def test_two_leds_on_the_last_axis_leave_that_joint_empty_and_give_the_others() -> None:
    upright = [
        ScenarioLed(name=name, position_mm=(0.0, 0.0, height), normal=(1.0, 0.0, 0.0))
        for name, height in (("A", 20.0), ("B", 110.0))
    ]
    recording = ScenarioRecording(pairs=14, rate_hz=10.0)
    session = in_memory(
        scene(marker=ScenarioMarker(led=upright), recording=recording, clock=ScenarioClock())
    )
    frames = analyse(session).tables["frames"]
    assert (set(frames["status"]), set(frames["known_dof"])) == ({"measured"}, {5})
    measured, u = joint_columns(frames)
    assert np.isnan(measured[:, 5]).all()
    assert np.isnan(u[:, 5]).all()
    off = (measured - np.rad2deg(session.truth))[:, :5]
    assert np.abs(off / u[:, :5]).max() < 4.2  # 70 figures: 2e-3 by chance
    assert frames["orientation_error_deg"].isna().all()


@pytest.mark.slow
def test_two_leds_in_motion_give_means_where_no_pair_gives_an_angle() -> None:
    session = in_memory(
        scene(
            marker=TWO, recording=ScenarioRecording(pairs=24, rate_hz=10.0), clock=ScenarioClock()
        )
    )
    results = analyse(session)
    frames = results.tables["frames"]
    assert set(frames["known_dof"]) == {5}
    # the line of these two lies across all axes: a turn about it moves every joint
    assert np.isnan(joint_columns(frames)[0]).all()
    for joint in results.summary["joints"]:
        assert abs(joint["mean_error_deg"]) < 3.5 * joint["standard_uncertainty_deg"]
    assert results.summary["diagnosis"] == []


def skewed(pairs: int, **changes: object) -> Scenario:
    """The right camera 4 ms late, give or take 0.6: as recorded with two free-running cameras."""
    motion = MultiJoint(home_deg=HOME_DEG, amplitude_deg=[8.0, 5.0, 8.0, 10.0, 12.0, 20.0])
    recording = ScenarioRecording(pairs=pairs, rate_hz=15.0, skew_s=0.004, skew_jitter_s=0.0006)
    return scene(**{"marker": FOUR, "motion": motion, "recording": recording, **changes})


def test_the_first_pair_borrows_its_successors_motion() -> None:
    session, measurements = measured(skewed(6))
    assert [m.frame for m in measurements] == list(range(6))
    first = measurements[0]
    assert first.status == "measured"
    assert np.linalg.norm(first.pose.twist) > 0.01
    assert np.abs(whitened(wrong(session, [first]), claimed([first]))).max() < 4


def test_a_pair_whose_motion_nothing_shows_is_unaligned_not_guessed() -> None:
    gone, later = ([Occlusion(led=name, first=i, last=i) for name in "ABCD"] for i in (3, 5))
    for scenario, expected in (
        # what neither neighbour shows: the one after is lost as well
        (skewed(6, occlusion=gone + later),
         {3: "too_few_leds", 4: "unaligned", 5: "too_few_leds"}),
        (skewed(6, occlusion=gone), {3: "too_few_leds"}),
        (skewed(1), {}),  # a single visit: taken as standing still
        (scene(marker=FOUR, recording=ScenarioRecording(pairs=6, rate_hz=15.0), occlusion=gone),
         {3: "too_few_leds"}),
        (scene(marker=FOUR, recording=ScenarioRecording(pairs=1, rate_hz=15.0)), {}),
    ):  # fmt: skip
        assert {
            m.frame: m.status for m in measured(scenario)[1] if m.status != "measured"
        } == expected


@pytest.mark.parametrize("late", [0.02, 0.037, -0.037])
def test_pictures_that_were_not_taken_together_are_an_outlier(late: float) -> None:
    rig, marker = facing_rig()
    run = SpotRun(rig, marker, 15.0)
    pairs = [
        replace(p, right=picture(run.spots(1, p.t_right + late))) if p.frame == 10 else p
        for p in run.pairs(1.2)
    ]
    with without_pictures():
        found = {m.frame: m.status for m in measure(pairs, Setup(rig, marker))}
    assert found.pop(10) == "outlier"
    assert set(found.values()) == {"measured"}


def test_spots_whose_fit_takes_no_finite_step_are_an_outlier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def diverge(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError

    rig, marker = facing_rig()
    monkeypatch.setattr(chain, "fit_stack", diverge)
    with without_pictures():
        found = list(measure(SpotRun(rig, marker, 15.0).pairs(0.3), Setup(rig, marker)))
    assert {(m.status, m.pose) for m in found} == {("outlier", None)}


def test_single_visits_are_taken_as_standing_still() -> None:
    session, measurements = played(
        motion=Visits(home_deg=HOME_DEG, amplitude_deg=[10.0] * 6),
        recording=ScenarioRecording(pairs=8, rate_hz=0.02, skew_s=0.004, skew_jitter_s=0.0006),
    )
    assert [m.status for m in measurements] == ["measured"] * 8
    assert all(m.whole_frame for m in measurements)  # nothing says where the arm went meanwhile
    scatter = whitened(wrong(session, measurements), claimed(measurements))
    assert 0.45 < np.mean(scatter**2) < 1.7  # 48 coordinates: chi² between 0.1 and 99.9 %


def strided(value: Any) -> Any:
    """The same numbers, no two of them one behind the other; records: their arrays."""
    if isinstance(value, np.ndarray):
        apart = np.empty(tuple(2 * n for n in value.shape), value.dtype)
        view = apart[(slice(None, None, 2),) * value.ndim]
        view[...] = value
        return view
    if is_dataclass(value) and not isinstance(value, type):
        given = [f.name for f in fields(value) if f.init]
        return replace(value, **{name: strided(getattr(value, name)) for name in given})
    return value


def test_arrays_of_any_layout_measure_the_same() -> None:
    session = simulate_session(scene(marker=FOUR, rig=SMALL))
    pairs = list(islice(rendered(session), 4))
    apart = [replace(p, left=strided(p.left), right=strided(p.right)) for p in pairs]
    setup = Setup(strided(session.rig), strided(session.marker))
    assert not setup.rig.left.matrix.flags.c_contiguous
    for one, other in zip(
        measure(iter(pairs), Setup(session.rig, session.marker)),
        measure(iter(apart), setup), strict=True,
    ):  # fmt: skip
        assert one.pose is not None
        assert other.pose is not None
        np.testing.assert_array_equal(other.pose.rig_T_flange, one.pose.rig_T_flange)
        np.testing.assert_array_equal(other.pose.covariance, one.pose.covariance)
