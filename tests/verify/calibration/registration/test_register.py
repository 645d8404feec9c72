from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import robots
from reports import render_html
from robots.transforms import difference
from tests.support.moved_rig import turned
from tests.support.recorded import PAIRS, require_shared, write_session
from tests.support.simulated import InMemory, in_memory, sample
from verify.calibration.registration import register
from verify.calibration.registration.led_tracks import PairSpots, find_spots
from verify.calibration.registration.records import MotionRegistration
from verify.calibration.registration.refusals import refuse_undetermined
from verify.calibration.registration.register import register_motion
from verify.calibration.registration.results import motion_results
from verify.core.fiducials import Marker
from verify.core.records import Array
from verify.core.rig import Covariance, Rig
from verify.errors import InputError
from verify.io.session.session import Recording, open_recording, open_session
from verify.measurement.systematics import unit

ARM = robots.load("iust_6r")
HOME = np.deg2rad([30.0, -62.0, 46.0, 8.0, -84.0, 24.0])
NOISE = (1e-4, np.deg2rad(0.02))


def base_and_leds(rig: Rig) -> tuple[list[str], Array]:
    """Names and covariance of what was registered, SI, as the rig states it."""
    stated = rig.covariance
    mine = [i for i, n in enumerate(stated.parameters) if n.startswith(("robot_base.", "led."))]
    names = [stated.parameters[i] for i in mine]
    sigma = stated.standard_uncertainty[mine] * np.array([unit(n) for n in names])
    return names, stated.correlation[np.ix_(mine, mine)] * np.outer(sigma, sigma)


def off(found: MotionRegistration, rig_T_base: Array, marker: Marker) -> Array:
    """Base and LEDs found less true ones, m and rad."""
    base = difference(found.rig.rig_T_base[None], rig_T_base[None])[0]
    return np.concatenate([base, (found.marker.leds - marker.leds).ravel()])


def shared_session() -> Path:
    return require_shared() / "multi_joint_fault_6r"


@cache
def looks() -> Sequence[PairSpots]:
    return find_spots(open_recording(shared_session()), lambda _done, _total: None)


@pytest.fixture
def recording(monkeypatch: pytest.MonkeyPatch) -> Recording:
    """Its joint 3 reads 0.40° too high. Its pictures are searched once for all tests."""
    pairs = list(looks())
    monkeypatch.setattr(register, "find_spots", lambda _recording, _progress: pairs)
    return open_recording(shared_session())


def with_offset(recording: Recording, joint: int, offset_deg: float) -> Recording:
    q = recording.encoders.q.copy()
    q[:, joint] += np.deg2rad(offset_deg)
    return replace(recording, encoders=replace(recording.encoders, q=q))


@pytest.mark.shared
def test_base_and_leds_of_the_recorded_session_are_found_once_its_fault_is_mended(
    recording: Recording,
) -> None:
    truth = open_session(shared_session())
    found = register_motion(with_offset(recording, 2, -0.40), marker=truth.marker)
    assert found.pairs_used == 90
    assert found.left_out == {}
    assert found.clock_offset == pytest.approx(0.137, abs=0.0002)
    error = off(found, truth.rig.rig_T_base, truth.marker)
    _, covariance = base_and_leds(found.rig)
    # one session of one renderer; that the covariance is right on average is tested below
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.9999, len(error))
    assert np.abs(error[:3]).max() < 0.2e-3
    assert np.abs(error[6:]).max() < 0.1e-3
    assert found.misfit == pytest.approx(1.0, abs=0.2)
    assert found.held_out_rms_px < 1.3 * found.fit_rms_px


@pytest.mark.shared
def test_without_a_marker_the_same_leds_are_found_under_names_of_their_own(
    recording: Recording,
) -> None:
    found = register_motion(recording)
    assert found.marker.names == ("A", "B", "C", "D")
    assert found.marker.led_diameter == pytest.approx(5e-3, abs=0.3e-3)
    truth = open_session(shared_session()).marker.leds
    nearest = np.linalg.norm(found.marker.leds[:, None] - truth, axis=2).min(axis=1)
    assert nearest.max() < 1.5e-3  # what joint 3's fault, taken in, does to them


@pytest.mark.slow
@pytest.mark.shared
def test_both_files_carry_one_id_that_comes_from_what_they_hold(recording: Recording) -> None:
    one, two = register_motion(recording), register_motion(recording)
    other = register_motion(with_offset(recording, 4, 0.1))
    assert one.rig.registration == one.marker.registration == two.rig.registration
    assert one.rig.registration.startswith("sha256:")
    assert other.rig.registration != one.rig.registration
    assert (one.rig.base_source, one.marker.source) == ("motion", "motion")


@pytest.mark.shared
def test_a_base_from_a_fixture_is_kept(recording: Recording) -> None:
    found = register_motion(recording, keep_base=True)
    np.testing.assert_array_equal(found.rig.rig_T_base, recording.rig.rig_T_base)
    assert (found.rig.base_source, found.marker.source) == ("fixture", "motion")
    assert not found.rig.absorption[:6].any()
    assert found.visible_fractions[5] == 0
    assert found.visible_fractions[0] > 0.2


@pytest.mark.slow
@pytest.mark.shared
def test_leds_known_from_a_jig_are_kept_and_their_uncertainty_reaches_the_base(
    recording: Recording,
) -> None:
    exact = open_session(shared_session()).marker
    doubtful = replace(exact, body_standard_uncertainty=np.array([1e-4] * 3 + [1e-3] * 3))
    found = register_motion(recording, marker=doubtful, keep_leds=True)
    np.testing.assert_array_equal(found.marker.leds, exact.leds)
    assert (found.rig.base_source, found.marker.source) == ("motion", None)
    assert found.marker.body_standard_uncertainty is None  # it is in the rig's covariance now
    names, covariance = base_and_leds(found.rig)
    assert "led.A.x_mm" in names
    _, plain = base_and_leds(register_motion(recording, marker=exact, keep_leds=True).rig)
    base = [names.index(n) for n in names if n.startswith("robot_base.")]
    assert covariance[base, base].sum() > plain.trace()
    assert found.visible_fractions[5] > 0.8


@pytest.mark.slow
@pytest.mark.shared
def test_what_the_rig_states_of_itself_reaches_base_and_leds_with_its_correlation(
    recording: Recording,
) -> None:
    u = 0.01  # deg
    names = ("right.mount_ry_deg", "left.fx_px", "robot_base.x_mm")
    stated = Covariance(names, np.array([u, 0.3, 5.0]), np.eye(3))
    found = register_motion(replace(recording, rig=replace(recording.rig, covariance=stated)))
    given = found.rig.covariance
    assert given.parameters[:3] == ("right.mount_ry_deg", "left.fx_px", "robot_base.x_mm")
    assert given.standard_uncertainty[2] < 2.0  # the old base's 5 mm is gone with the old base
    # brute force: register again in a rig whose right camera is turned by u about its own y
    other = replace(recording.rig, right=turned(recording.rig.right, 1, u))
    plain = register_motion(recording)
    by_other = register_motion(replace(recording, rig=other))
    moved = difference(by_other.rig.rig_T_base[None], plain.rig.rig_T_base[None])[0]
    z = given.parameters.index("robot_base.z_mm")
    by_turn = given.correlation[0, z] * given.standard_uncertainty[z]
    assert by_turn == pytest.approx(moved[2] * 1e3, rel=0.05, abs=0.01)


@pytest.fixture(scope="module")
def simulated() -> InMemory:
    return in_memory(msgspec.structs.replace(sample(), fault=[], tolerance=None))


@pytest.fixture(scope="module")
def registered(simulated: InMemory) -> MotionRegistration:
    return register_motion(simulated, marker=simulated.marker)


def test_a_healthy_simulated_arm_is_registered_to_within_its_uncertainty(
    simulated: InMemory, registered: MotionRegistration
) -> None:
    error = off(registered, simulated.rig.rig_T_base, simulated.marker)
    _, covariance = base_and_leds(registered.rig)
    assert error @ np.linalg.solve(covariance, error) < chi2.ppf(0.99, len(error))
    assert abs(registered.clock_offset - 0.085) < 3 * registered.clock_standard_uncertainty
    assert abs(registered.skew) < 4 * registered.skew_standard_uncertainty


def test_pairs_that_the_readings_contradict_are_left_out_and_named(
    simulated: InMemory, monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs = find_spots(simulated, lambda _done, _total: None)
    monkeypatch.setattr(register, "find_spots", lambda _recording, _progress: pairs)
    read = simulated.encoders
    q = read.q.copy()
    slipped = (read.t > read.t[0] + 2.0) & (read.t < read.t[0] + 2.2)
    q[slipped, 1] += np.deg2rad(4.0)
    wrong = replace(simulated, encoders=replace(read, q=q))
    sound = register_motion(simulated, keep_base=True, marker=simulated.marker)
    found = register_motion(wrong, keep_base=True, marker=simulated.marker)
    assert set(found.left_out.values()) == {"the readings contradict it"}
    at = {f: simulated.frames.t_left[f] - found.clock_offset for f in found.left_out}
    assert all(1.95 < t - read.t[0] < 2.25 for t in at.values())
    assert found.pairs_used == sound.pairs_used - len(found.left_out)
    assert found.misfit == pytest.approx(sound.misfit, rel=0.15)
    np.testing.assert_allclose(found.visible_fractions, sound.visible_fractions, atol=0.03)


def test_results_are_laid_out_in_the_file_s_units(registered: MotionRegistration) -> None:
    found = replace(registered, left_out={5: "why", 6: "why"})
    results = motion_results(found, robot="iust_6r")
    base, leds = results.summary["base"], results.summary["leds"]
    u = np.sqrt(np.diag(base_and_leds(found.rig)[1]))
    np.testing.assert_allclose(base["position_mm"], 1e3 * found.rig.rig_T_base[:3, 3])
    turn = Rotation.from_rotvec(base["rotation_vector_deg"], degrees=True).as_matrix()
    np.testing.assert_allclose(turn, found.rig.rig_T_base[:3, :3], atol=1e-12)
    np.testing.assert_allclose(base["standard_uncertainty_mm"], 1e3 * u[:3])
    np.testing.assert_allclose(base["standard_uncertainty_deg"], np.rad2deg(u[3:6]))
    for entry, place, own in zip(leds, found.marker.leds, u[6:].reshape(-1, 3), strict=True):
        np.testing.assert_allclose([entry[f"{axis}_mm"] for axis in "xyz"], 1e3 * place)
        np.testing.assert_allclose([entry[f"u_{axis}_mm"] for axis in "xyz"], 1e3 * own)
    assert results.summary["pairs"] == {"used": found.pairs_used, "left_out": {"why": 2}}
    assert set(results.tables["residuals"]["led"]) == set(found.marker.names)
    assert "some encoder offsets stay hidden" in render_html(results)
    silent = replace(found, rig=replace(found.rig, covariance=None))
    assert motion_results(silent, robot="iust_6r").summary["leds"][0]["u_x_mm"] is None


@pytest.mark.slow
def test_an_unstated_skew_is_found_and_reported(simulated: InMemory) -> None:
    frames = simulated.frames
    late = replace(simulated, frames=replace(frames, t_right=frames.t_right - 0.003))
    pairs = [
        replace(one, t=(one.t[0], one.t[1] - 0.003))
        for one in find_spots(simulated, lambda _done, _total: None)
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(register, "find_spots", lambda _recording, _progress: pairs)
        found = register_motion(late)
    assert found.skew == pytest.approx(0.003, abs=0.0002)
    assert any("right camera's stamps" in message for message in found.warnings)


def swing(joints: Sequence[int], degrees: float, n: int = 30) -> Array:
    q = np.tile(HOME, (n, 1))
    for k, j in enumerate(joints):
        q[:, j] += np.deg2rad(degrees) * np.sin(np.linspace(0, 2 * np.pi, n) * (k + 1) + k)
    return q


# joints 2 to 4 cancel: pure translation
WITHOUT_TURNS = HOME + np.deg2rad(np.outer(np.linspace(-15, 15, 20), [0, 1, -2, 1, 0, 0]))


@pytest.mark.parametrize(
    ("q", "message"),
    [
        (swing([0], 20), "position along joint 1's axis.* turn about joint 1's.*Add a movement of"),
        (swing([1, 2, 3], 20), "along joint [234]'s axis"),
        (swing([], 0.0), "the base's position and its orientation"),
        (swing([0, 2, 4], 0.05), "the base's position and its orientation"),
        (WITHOUT_TURNS, "the base's position"),
    ],
    ids=["one joint", "parallel axes", "at rest", "hardly a motion", "no turns"],
)  # fmt: skip
def test_a_motion_that_leaves_something_open_is_refused(q: Array, message: str) -> None:
    with pytest.raises(InputError, match=message):
        refuse_undetermined(ARM, q, NOISE, "here")


def test_two_axes_that_are_not_parallel_suffice() -> None:
    refuse_undetermined(ARM, swing([0, 4], 20), NOISE, "here")


def test_keeping_both_leaves_nothing_to_register(simulated: InMemory) -> None:
    with pytest.raises(InputError, match="nothing is left"):
        register_motion(simulated, keep_base=True, keep_leds=True, marker=simulated.marker)
    with pytest.raises(InputError, match="--leds: is 3, and the known marker has 4 LEDs"):
        register_motion(simulated, leds=3, marker=simulated.marker)


def test_what_is_kept_and_does_not_fit_is_named(simulated: InMemory) -> None:
    """An LED 5 mm from where marker.toml has it; a base 50 mm from where rig.toml has it."""
    leds = simulated.marker.leds.copy()
    leds[0, 0] += 5e-3
    with pytest.raises(InputError, match=r"puts LED A 5\.0 mm from where the pictures show it"):
        register_motion(simulated, marker=replace(simulated.marker, leds=leds), keep_leds=True)
    base = simulated.rig.rig_T_base.copy()
    base[0, 3] += 0.05
    moved = replace(simulated, rig=replace(simulated.rig, rig_T_base=base))
    with pytest.raises(InputError, match="base and LEDs elsewhere than those kept fit"):
        register_motion(moved, keep_base=True)


def test_a_rig_that_most_spots_contradict_is_refused_one_that_some_do_warned_of(
    simulated: InMemory,
) -> None:
    """A camera turned by 1.1° from where the rig has it; a base held 5 mm beside its place."""
    rig = simulated.rig
    yawed = replace(rig, left=replace(rig.left, pan_zero=rig.left.pan_zero + 0.02))
    with pytest.raises(InputError, match=r"of \d+ spots contradict the others"):
        register_motion(replace(simulated, rig=yawed))
    base = rig.rig_T_base.copy()
    base[0, 3] += 0.005
    moved = replace(simulated, rig=replace(rig, rig_T_base=base))
    warnings = register_motion(moved, keep_base=True).warnings
    assert any("spots contradict the others and were rejected, of LED" in w for w in warnings)


@pytest.mark.parametrize("joint", [2, 3, 5])
def test_a_joint_whose_zero_is_far_off_is_named(simulated: InMemory, joint: int) -> None:
    zero = rf"joint {joint} with its zero moved by about -20° fits"
    with pytest.raises(InputError, match=zero) as refused:
        register_motion(with_offset(simulated, joint - 1, 20.0))
    assert refused.value.remedy == f"Set the zero of joint {joint} anew."


def test_a_recording_needs_neither_a_robot_base_nor_a_marker(tmp_path: Path) -> None:
    folder = write_session(tmp_path / "monday")
    (folder / "marker.toml").unlink()
    text = (folder / "rig.toml").read_text()
    (folder / "rig.toml").write_text(text[: text.index("[robot_base]")])
    recording = open_recording(folder)
    assert not recording.rig.registered
    assert len(recording) == PAIRS
    assert "marker.toml" not in recording.inputs
    with pytest.raises(InputError, match="marker"):
        open_session(folder)


def test_another_rig_may_be_given_in_place_of_the_sessions_own(tmp_path: Path) -> None:
    folder = write_session(tmp_path / "monday")
    other = tmp_path / "other.toml"
    other.write_text((folder / "rig.toml").read_text().replace("-60.0", "-61.0"))
    session_toml = (folder / "session.toml").read_text()
    (folder / "session.toml").write_text(session_toml.replace('rig = "rig.toml"\n', ""))
    recording = open_recording(folder, rig=other)
    assert recording.rig.left.pan_center[0] == pytest.approx(-0.061)
    assert str(other) in recording.inputs
    with pytest.raises(InputError, match="rig: is missing"):
        open_recording(folder)
