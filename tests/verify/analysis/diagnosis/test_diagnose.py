"""The diagnosis on tracks with known truth: every kind of fault, several at once, outlying pairs.

Faults of joints are put into readings by the law of docs/results.md, the others into poses.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import robots
from tests.support.motions import (
    ARM,
    GIVEN,
    HOME,
    PERIOD,
    compared,
    compared_session,
    make_track,
    model_of,
)
from tests.support.scene import make_marker, make_rig
from tests.support.simulated import in_memory, measured_at_spots, scene
from verify import analyse
from verify.analysis.comparison import base_motion, body_motion, compare, relinearise
from verify.analysis.diagnosis import diagnose
from verify.analysis.diagnosis.detectability import detectable
from verify.analysis.diagnosis.diagnose import Diagnosis, find_causes
from verify.analysis.diagnosis.link_faults import link_displacements, link_faults
from verify.analysis.joint_errors import ResolvedErrors, resolve_errors
from verify.analysis.model import (
    visibility,
)
from verify.analysis.results.entries import cause_entry
from verify.analysis.session import session_model
from verify.analysis.verdict import judge_joint
from verify.core.readings import Readings
from verify.core.records import Array
from verify.measurement.systematics import stated_systematics
from verify.measurement.track import Track
from verify.simulation.scenario import ScenarioFault, ScenarioRecording

T = np.linspace(1.0, 13.0, 90)
LOG = np.arange(0.0, 14.0, 0.02)
SWING = np.deg2rad([40.0, 25.0, 30.0, 30.0, 40.0, 60.0])
Error = Callable[[Array, Array], Array]  # of t (n,) and q (n, 6), rad: (n, 6)


def motion(t: Array) -> Array:
    return HOME + SWING * np.sin(2 * np.pi * t[:, None] / PERIOD + np.arange(6))


def at(joint: int, values: Array | float) -> Array:
    return np.asarray(values)[..., None] * np.eye(6)[joint - 1]


def direction(t: Array) -> Array:
    return np.sign(np.cos(2 * np.pi * t[:, None] / PERIOD + np.arange(6)))


def found(
    seed: int,
    error: Error | None = None,
    clock: Callable[[Array], Array] = lambda t: t,
    change: Callable[[Track], Track] = lambda track: track,
    source: str = "fixture",
    move: Callable[[Array], Array] = motion,
    noise_deg: float = 0.005,
) -> Diagnosis:
    rng = np.random.default_rng(seed)
    track = change(make_track(T, move(T), rng))
    q = move(LOG) + rng.normal(0, np.deg2rad(noise_deg), (len(LOG), 6))
    if error is not None:
        q = q + error(LOG, move(LOG))
    comparison = compare(track, ARM, Readings(clock(LOG), q), 0.0)
    model = model_of(track, comparison, source, "jig" if source == "fixture" else source)
    return find_causes(model, resolve_errors(model), ARM, replace(make_rig(), base_source=source))


def names(seen: Diagnosis) -> list[tuple[str, int | None]]:
    return [(c.kind, c.joint) for c in seen.causes]


def built_as(arm: robots.Arm) -> Callable[[Track], Track]:
    """What the poses show of an arm that is not the file's."""
    through = np.linalg.inv(robots.forward(ARM, motion(T))) @ robots.forward(arm, motion(T))
    return lambda track: replace(track, base_T_flange=track.base_T_flange @ through)


FAULTS: dict[str, tuple[int, Error, float]] = {
    "offset": (3, lambda t, _: at(3, np.deg2rad(0.15) + 0 * t), 0.15),
    "gain": (2, lambda _, q: at(2, 0.004 * q[:, 1]), 0.004),
    "backlash": (4, lambda t, _: at(4, np.deg2rad(0.1) * direction(t)[:, 3]), 0.2),
    "eccentricity": (6, lambda _, q: at(6, np.deg2rad(0.25) * np.cos(3 * (q[:, 5] - 0.4))), 0.25),
    "latency": (3, lambda t, q: at(3, (motion(t - 0.005) - q)[:, 2]), 0.005),
    "drift": (5, lambda t, _: at(5, np.deg2rad(0.02) * (t - T[0])), 72.0),
    "step": (4, lambda t, _: at(4, np.deg2rad(-0.3) * (t >= T[60] - 0.05)), -0.3),
    "compliance": (5, lambda _, q: at(5, np.deg2rad(4.0) * robots.jacobian(ARM, q)[:, 2, 4]), 4.0),
}


@pytest.mark.parametrize("kind", FAULTS)
def test_each_kind_of_fault_of_a_joint_is_named_with_its_value(kind: str) -> None:
    joint, error, value = FAULTS[kind]
    seen = found(1, error)
    assert names(seen) == [(kind, joint)]
    entry = cause_entry(seen.causes[0])
    assert abs(entry["value"] - value) < 2 * entry["expanded_uncertainty"]  # 4 u
    assert entry["standard_uncertainty"] < 0.1 * abs(value)
    assert entry["runner_up"]["advantage"] > 15


@pytest.mark.parametrize("gain", [0.03, -0.03])
def test_a_gain_is_the_share_of_the_true_angle_and_not_of_the_reading(gain: float) -> None:
    recording = ScenarioRecording(pairs=40, rate_hz=10.0)
    session = in_memory(scene(recording=recording, fault=[ScenarioFault(joint=5, gain=gain)]))
    stated = stated_systematics(session.rig, session.marker, turning=False)
    rng = np.random.default_rng(3)
    results = analyse(session, chain=lambda *_: measured_at_spots(session, stated, rng))
    (cause,) = results.summary["diagnosis"]
    assert (cause["kind"], cause["joint"]) == ("gain", 5)
    assert abs(cause["value"] - gain) < 2 * cause["expanded_uncertainty"]  # 4 u
    assert cause["expanded_uncertainty"] < 1e-4  # of the reading it is 0.0291 or -0.0309


@pytest.mark.parametrize("joint", [2, 3])
def test_of_an_arm_at_rest_no_large_faults_that_cancel_each_other_are_named(joint: int) -> None:
    """They would fit the readings' noise: links off by 200 mm beside a base that has moved."""
    offset = np.deg2rad(0.5)
    seen = found(
        1, lambda t, _: at(joint, offset + 0 * t), move=lambda t: HOME + 0 * t[:, None],
        noise_deg=0.02,
    )  # fmt: skip
    (cause,) = seen.causes
    suspects = {(c.fault.kind, c.fault.joint): c.value for c in cause.candidates or (cause,)}
    assert suspects["offset", joint] == pytest.approx(offset, abs=np.deg2rad(0.1))


@pytest.mark.parametrize("side", [1, -1])
def test_the_play_of_a_joint_that_first_rests_is_told_whichever_side_it_rests_on(side: int) -> None:
    """It turns back for a twelfth of the session: those pairs are no outliers."""
    ends, angles = [7.0, 9.0, 10.0, 11.0], np.deg2rad([0.0, 30.0, 15.0, 30.0])

    def move(t: Array) -> Array:
        return HOME + at(4, np.interp(t, ends, angles))

    def error(t: Array, _: Array) -> Array:
        way = np.select([t < ends[0], t < ends[1], t < ends[2]], [side, 1, -1], 1)
        return at(4, np.deg2rad(0.25) * way)

    seen = found(1, error, move=move, noise_deg=0.01)
    assert names(seen) == [("backlash", 4)]
    entry = cause_entry(seen.causes[0])
    assert abs(entry["value"] - 0.5) < 2 * entry["expanded_uncertainty"]


def test_no_drift_is_told_by_which_a_joint_would_be_20_degrees_off() -> None:
    drifts = [f for f in found(1).products.faults if f.kind == "drift" and f.begin is None]
    assert len(drifts) == 6
    for fault in drifts:
        assert np.rad2deg(fault.largest.item() * (T[-1] - T[0])) == pytest.approx(20.0)


def test_an_eccentricity_comes_with_its_phase_and_number_of_waves() -> None:
    seen = found(2, FAULTS["eccentricity"][1])
    entry = cause_entry(seen.causes[0])
    assert entry["per_turn"] == 3
    assert len(detectable(seen.products)) == len(detectable(found(2).products))
    turn = (entry["phase_deg"] - np.rad2deg(0.4) + 60) % 120 - 60  # the same again after 120°
    assert abs(turn) < 3


def waves(joint: int, *numbers: int) -> Error:
    return lambda _, q: at(
        joint, sum(np.deg2rad(0.15) * np.cos(n * (q[:, joint - 1] - 0.3)) for n in numbers)
    )


@pytest.mark.parametrize(
    ("swing_deg", "numbers"),
    [
        (18.0, (13,)),
        (18.0, (40,)),
        (18.0, (119,)),
        (18.0, (11, 97)),
        (60.0, (41,)),
        (60.0, (9, 50)),
    ],
)
def test_waves_of_any_number_a_turn_are_told_as_what_they_are(
    swing_deg: float, numbers: tuple[int, ...]
) -> None:
    def move(t: Array) -> Array:
        swing = np.where(np.arange(6) == 2, np.deg2rad(swing_deg), SWING)
        return HOME + swing * np.sin(2 * np.pi * t[:, None] / PERIOD + np.arange(6))

    seen = found(5, waves(3, *numbers), move=move)
    entries = [cause_entry(cause) for cause in seen.causes]
    told = {e["per_turn"]: e for e in entries if (e["kind"], e["joint"]) == ("eccentricity", 3)}
    assert sorted(told) == list(numbers)
    assert len(entries) == len(numbers)
    for entry in told.values():
        assert abs(entry["value"] - 0.15) < 2 * entry["expanded_uncertainty"]
        assert entry["expanded_uncertainty"] < 0.15 / 6


def test_waves_of_a_short_swing_come_with_all_numbers_that_explain_them() -> None:
    def move(t: Array) -> Array:
        swing = np.where(np.arange(6) == 2, np.deg2rad(7.0), SWING)
        return HOME + swing * np.sin(2 * np.pi * t[:, None] / PERIOD + np.arange(6))

    (cause,) = found(5, lambda t, q: 0.3 * waves(3, 40)(t, q), move=move).causes
    entry = cause_entry(cause)
    assert (entry["kind"], entry["joint"]) == ("eccentricity", 3)
    assert 40 in entry["per_turn_candidates"]
    assert len(entry["per_turn_candidates"]) > 1
    assert "phase_deg" not in entry
    assert abs(entry["value"] - 0.045) < 1.5 * entry["expanded_uncertainty"]


def test_clock_offset_and_clock_drift_are_distinguished() -> None:
    seen = found(3, clock=lambda t: t - 0.004)
    assert names(seen) == [("clock", None)]
    assert_allclose(cause_entry(seen.causes[0])["value"], 0.004, atol=2e-4)
    seen = found(3, clock=lambda t: t - 5e-4 * (t - T[0]))
    assert names(seen) == [("clock_drift", None)]
    assert_allclose(cause_entry(seen.causes[0])["value"], 500, rtol=0.1)


def test_what_moved_since_registration_is_named_with_how_far() -> None:
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(np.deg2rad([0.1, -0.15, 0.1])).as_matrix()
    step[:3, 3] = [0.8e-3, -0.5e-3, 0.6e-3]

    def moved(track: Track) -> Track:
        return replace(track, base_T_flange=step @ track.base_T_flange)

    def slipped(track: Track) -> Track:
        return replace(track, base_T_flange=track.base_T_flange @ step)

    def since(change: Callable[[Track], Track], first: int) -> Callable[[Track], Track]:
        def late(track: Track) -> Track:
            after = (np.arange(len(T)) >= first)[:, None, None]
            pose = np.where(after, change(track).base_T_flange, track.base_T_flange)
            return replace(track, base_T_flange=pose)

        return late

    for first, source in ((0, "fixture"), (52, "fixture"), (52, "motion")):
        for change, kind in ((moved, "base_moved"), (slipped, "led_body_slipped")):
            seen = found(4, change=since(change, first), source=source)
            assert names(seen) == [(kind, None)]
            entry = cause_entry(seen.causes[0])
            assert_allclose(entry["value"], 1e3 * np.linalg.norm(step[:3, 3]), rtol=0.1)
            assert_allclose(entry["turn_deg"], np.sqrt(0.1**2 * 2 + 0.15**2), rtol=0.1)
            assert entry.get("t_s") == (pytest.approx(T[51:53].mean()) if first else None)


def judged(q: Array, place: Array) -> tuple[Diagnosis, ResolvedErrors, list[str | None]]:
    """What is found, resolved, and the verdicts at 0.1°; the base had moved by `place`."""
    rng = np.random.default_rng(21)
    q = q + motion(LOG) + rng.normal(0, np.deg2rad(0.005), (len(LOG), 6))
    rig, marker = replace(make_rig(), base_source="fixture"), make_marker(source="jig")
    track = make_track(T, motion(T), rng)
    track = replace(track, base_T_flange=place @ track.base_T_flange)
    stated = stated_systematics(rig, marker, turning=False)
    comparison = compare(track, ARM, Readings(LOG, q), 0.0)
    compared = compared_session(track, comparison, stated, GIVEN, rig=rig, marker=marker)
    model, seen, resolved = session_model(compared)
    smallest = visibility(model).detectable
    limit = np.deg2rad(0.1)
    return seen, resolved, [judge_joint(resolved, j, limit, smallest[j]).verdict for j in range(6)]


def test_a_step_is_dated_and_leaves_the_other_joints_their_verdict() -> None:
    """The pairs repeat the step from its instant on: that is no noise of theirs."""
    late = at(4, np.deg2rad(0.8) * (T[40] - 0.05 <= LOG))
    seen, resolved, verdicts = judged(late, np.eye(4))
    assert names(seen) == [("step", 4)]
    assert cause_entry(seen.causes[0])["t_s"] == pytest.approx(T[39:41].mean())
    assert not resolved.lack_of_fit
    assert resolved.uncertainty.max() < np.deg2rad(0.03)
    assert verdicts == ["conform"] * 3 + ["nonconform"] + ["conform"] * 2


def test_a_base_that_had_moved_is_no_error_of_sound_joints_and_hides_no_large_one() -> None:
    place = np.eye(4)
    place[:3, :3] = Rotation.from_rotvec(np.deg2rad([0.3, -0.2, 0.3])).as_matrix()
    place[:3, 3] = [2e-3, -1e-3, 1e-3]
    for error in (0.0, np.deg2rad(2.0)):
        seen, resolved, verdicts = judged(at(4, np.full(len(LOG), error)), place)
        assert ("base_moved", None) in names(seen)
        assert "nonconform" not in verdicts[:3] + verdicts[4:]
        assert (verdicts[3] == "nonconform") == (error > 0)
        off = resolved.mean - error * (np.arange(6) == 3)
        assert np.all(np.abs(off) < 3 * np.sqrt(np.diag(resolved.mean_covariance)))


@pytest.mark.parametrize(
    ("key", "joint", "value", "unit"), [("a", 2, 5e-4, 1e3), ("alpha", 3, 2e-3, 180 / np.pi)]
)
def test_a_wrong_link_is_named_with_what_to_add_to_the_robot_file(
    key: str, joint: int, value: float, unit: float
) -> None:
    column = getattr(ARM, key) + value * np.eye(6)[joint - 1]
    bent = replace(ARM, **{key: column})

    seen = found(5, change=built_as(bent))
    assert names(seen) == [("dh", joint)]
    entry = cause_entry(seen.causes[0])
    assert entry["parameter"] == f"{key}{joint}"
    assert abs(entry["value"] - unit * value) < 2 * entry["expanded_uncertainty"]


def test_many_wrong_links_are_one_finding_and_no_joint_fault() -> None:
    rng = np.random.default_rng(3)
    bent = replace(
        ARM,
        a=ARM.a + 4e-4 * rng.standard_normal(6),
        d=ARM.d + 4e-4 * rng.standard_normal(6),
        alpha=ARM.alpha + np.deg2rad(0.05) * rng.standard_normal(6),
    )

    for source in ("fixture", "motion"):
        seen = found(14, change=built_as(bent), source=source)
        joints = [c for c in seen.causes if c.joint is not None]
        assert ("geometry", None) in names(seen)
        assert [c.kind for c in joints if c.kind != "dh"] == []
        seen = found(14, FAULTS["backlash"][1], change=built_as(bent), source=source)
        assert {("geometry", None), ("backlash", 4)} <= set(names(seen))


@pytest.mark.parametrize("name", ["iust_6r", "rv_3sd_melfa", "ur10", "panda"])
def test_displaced_links_span_what_a_dh_table_can_have_wrong(name: str) -> None:
    """30 in all with base, tool and zeros for six joints, five more for a seventh."""
    arm = robots.load(name)
    rng = np.random.default_rng(4)
    q = rng.uniform(np.maximum(arm.lower, -2), np.minimum(arm.upper, 2), (60, arm.dof))
    pose = robots.forward(arm, q)
    columns = [link_displacements(arm, q), base_motion(pose), body_motion(pose)]
    rows = np.concatenate([*columns, robots.jacobian(arm, q)], axis=2).reshape(360, -1)
    size = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)
    assert int(np.sum(size > 1e-9 * size[0])) == 4 * arm.dof + 6


def test_a_last_link_displaces_the_flange_as_the_led_body_does_wherever_that_is_linearised() -> (
    None
):
    """Along and about its x axis: columns made elsewhere would tell the one from the other."""
    track, comparison = compared(3)
    step = np.where(np.arange(len(comparison)) % 2, 0.0, np.deg2rad(2.0))[:, None] * np.ones(6)
    tangent = relinearise(comparison, ARM, step, 0 * step)
    model = model_of(track, tangent, "fixture", "jig")
    body = model.white.rows(body_motion(tangent.base_T_jacobian))
    links = {f.parameter: f.columns[:, 0] for f in link_faults(model, ARM)}
    for parameter, column in (("a6", 0), ("alpha6", 3), ("d6", 2)):
        assert_allclose(np.abs(links[parameter]), np.abs(body[:, column]), atol=1e-6)


@pytest.mark.parametrize("source", ["fixture", "motion"])
@pytest.mark.parametrize("joints", [(2, 4, 5), (1, 3, 5), (2, 3, 4, 5), (1, 2, 3, 4, 5, 6)])
def test_offsets_of_several_joints_are_each_named_and_no_links(
    joints: tuple[int, ...], source: str
) -> None:
    """Links have so many coefficients that they absorb the first two offsets of three."""
    size = {j: np.deg2rad(0.15) * (-1) ** k for k, j in enumerate(joints)}
    seen = found(8, lambda t, _: sum(at(j, s + 0 * t) for j, s in size.items()), source=source)
    hidden = {1, 6} if source == "motion" else set()  # the registration takes them in
    assert sorted(names(seen)) == [("offset", j) for j in joints if j not in hidden]
    for cause in seen.causes:
        assert cause.joint is not None
        assert abs(cause.value - size[cause.joint]) < 4 * cause.standard_uncertainty


def test_backlash_of_every_joint_is_named_and_no_steps_and_offsets_beside_it() -> None:
    play = np.deg2rad(0.3)
    seen = found(9, lambda t, _: play / 2 * direction(t))
    assert sorted(names(seen)) == [("backlash", j) for j in range(1, 7)]
    assert_allclose([c.value for c in seen.causes], play, rtol=0.1)


@pytest.mark.slow
def test_several_faults_at_once_are_each_named() -> None:
    def error(t: Array, q: Array) -> Array:
        return sum(
            (FAULTS[kind][1](t, q) for kind in ("offset", "gain", "backlash", "eccentricity")),
            np.zeros_like(q),
        )

    assert sorted(names(found(6, error)), key=str) == [
        ("backlash", 4),
        ("eccentricity", 6),
        ("gain", 2),
        ("offset", 3),
    ]


def test_ambiguous_faults_are_one_entry_with_a_separating_motion() -> None:
    table = detectable(found(7).products)
    own = table[(table["kind"] == "offset") & (table["joint"] == 4)].iloc[0]
    size = np.deg2rad(np.sqrt(1.5 * own["detectable"] * own["separable"] / 2))
    assert own["separable"] > 1.5 * own["detectable"]
    seen = found(7, lambda t, _: at(4, size + 0 * t))
    assert [c.kind for c in seen.causes] == ["ambiguous"]
    entry = cause_entry(seen.causes[0])
    assert (4, "offset") in {(c["joint"], c["kind"]) for c in entry["candidates"]}
    assert entry["joint"] is None
    assert entry["separating_motion"]
    assert 4 in entry["separating_joints"]


def test_outlying_pairs_are_listed_and_do_not_disturb() -> None:
    wild = np.array([10, 37, 61])

    def disturbed(track: Track) -> Track:
        pose = track.base_T_flange.copy()
        pose[wild, :3, 3] += [2e-3, -3e-3, 4e-3]
        return replace(track, base_T_flange=pose)

    clean, dirty = found(8, FAULTS["offset"][1]), found(8, FAULTS["offset"][1], change=disturbed)
    assert dirty.outlying.tolist() == wild.tolist()
    assert clean.outlying.tolist() == []
    assert names(dirty) == names(clean) == [("offset", 3)]
    assert_allclose(dirty.causes[0].value, clean.causes[0].value, atol=np.deg2rad(0.01))
    assert names(found(8, change=disturbed)) == []


def test_unmodelled_errors_give_no_finding() -> None:
    rng = np.random.default_rng(9)

    def rough(track: Track) -> Track:
        pose = track.base_T_flange.copy()
        pose[:, :3, 3] += 4e-4 * rng.standard_normal((len(T), 3))  # eight times what is stated
        return replace(track, base_T_flange=pose)

    seen = found(9, change=rough)
    assert seen.misfit > 5
    assert names(seen) == []


@pytest.mark.slow
def test_false_findings_on_healthy_arms_are_rare() -> None:
    assert sum(bool(found(100 + seed).causes) for seed in range(40)) <= 2  # 0.2 are expected


def test_hidden_offsets_are_not_stated_as_found() -> None:
    seen = found(10, lambda t, _: at(1, np.deg2rad(1.0) + 0 * t), source="motion")
    assert names(seen) == []
    table = detectable(seen.products)
    offsets = table[table["kind"] == "offset"].set_index("joint")["detectable"]
    assert np.isnan(offsets.get(1, np.nan))
    assert np.isnan(offsets.get(6, np.nan))
    moved = table[table["kind"] == "base_moved"]["detectable"]
    assert moved.isna().all()


def test_what_is_stated_as_detectable_is_what_least_squares_gives() -> None:
    """By plain algebra on the whitened rows: size = (threshold + 0.84) / ‖(I − P) column‖."""
    products = found(11).products
    table = detectable(products)
    i = next(k for k, f in enumerate(products.faults) if f.name == ("offset", 5, None))
    column = products.faults[i].columns[:, 0]  # nothing was fitted beside it: all is given
    size = (np.sqrt(products.price[i]) + 0.84) / np.linalg.norm(column)
    own = table[(table["kind"] == "offset") & (table["joint"] == 5)].iloc[0]
    assert_allclose(own["detectable"], np.rad2deg(size), rtol=1e-6)
    rest = []
    for k, rival in enumerate(products.faults):
        if rival.freedom == 1 and k != i:
            other = rival.columns[:, 0]
            left = column - other * (other @ column) / (other @ other)
            rest.append((np.sqrt(15.0) + 0.84) / np.linalg.norm(left))
    assert own["separable"] >= np.rad2deg(max(rest)) * (1 - 1e-6)


def test_a_long_session_is_thinned_and_pairs_keep_their_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(diagnose, "MAX_PAIRS", 45)

    def disturbed(track: Track) -> Track:
        pose = track.base_T_flange.copy()
        pose[:: len(T) - 1, 0, 3] += 5e-3  # the first and the last: of any choice
        return replace(track, base_T_flange=pose)

    seen = found(13, FAULTS["offset"][1], change=disturbed)
    assert seen.outlying.tolist() == [0, len(T) - 1]
    assert names(seen) == [("offset", 3)]
    assert seen.products.rows == 6 * 43
