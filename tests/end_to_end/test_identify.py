"""`verify identify` from the pictures to the corrected robot file, and what it refuses."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import block_diag

import robots
from robots.library import HERE
from robots.transforms import rotation_exp
from tests.support.beside import shared
from tests.support.command import SAMPLES, read_summary, verify
from tests.support.published import series, write_session
from tests.support.true_arm import faulty_arm, measured, readings, recorded, true_arm
from verify.calibration.kinematics.poses import build_poses
from verify.core.records import Array


@pytest.mark.shared
def test_a_session_gives_a_corrected_arm_with_its_sign_spelled_out(tmp_path: Path) -> None:
    session, out = shared("sessions", "multi_joint_fault_6r"), tmp_path / "out"
    done = verify("identify", session, "-o", out, "--splits", "2")
    assert done.status == 0, done.err
    assert "joint 3: encoder less measured +0.40" in done.out
    assert "to the reading" in done.out
    assert {entry.name for entry in out.iterdir()} == {
        "iust_6r_identified.toml", "parameters.csv", "report.html", "report.pdf", "results",
        "summary.json",
    }  # fmt: skip
    summary = read_summary(out)
    assert summary["kind"] == "identification"
    for true, found in zip([0, 0, 0.40, 0, 0, 0], summary["offsets"], strict=True):
        assert abs(found["error_deg"] - true) < 3 * found["standard_uncertainty_deg"] < 0.06
    third = summary["offsets"][2]
    assert third["add_to_reading_deg"] == -third["error_deg"]
    assert {h["name"] for h in summary["held"] if h["reason"] == "gauge"} == {"d_2", "d_3"}
    held_out = {level["name"]: level["held_out"]["mean_mm"] for level in summary["levels"]}
    assert held_out["offsets"] < 0.1 * held_out["registration"]
    parameters = pd.read_csv(out / "parameters.csv", index_col="name")
    assert parameters.loc["offset_3", "change"] == pytest.approx(third["add_to_reading_deg"])
    corrected = robots.load(str(out / "iust_6r_identified.toml"))
    assert isinstance(corrected, robots.DhArm)
    assert np.degrees(corrected.offset[2]) == pytest.approx(third["add_to_reading_deg"])
    assert verify("report", out).status == 0
    assert "Add to the reading" in (out / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize(("positions_alone", "rank"), [(False, 30), (True, 27)])
def test_a_laser_tracker_s_poses_need_no_registration(
    positions_alone: bool, rank: int, tmp_path: Path
) -> None:
    """A real UR10; where its base and the tracker's target are, nobody says."""
    at_rest = {"positions_alone": positions_alone, "period": 10.0}
    session, out = write_session(tmp_path / "b", series("B", 5), **at_rest), tmp_path / "out"
    # months before, with robot, tracker and target elsewhere
    other = write_session(tmp_path / "a", series("A", 40), **at_rest)
    free = ("--base", "free", "--leds", "free", "--splits", "2", "--judge", other)
    done = verify("identify", session, "-o", out, *free)
    assert done.status == 0, done.err
    summary = read_summary(out)
    assert (summary["level"], summary["rank"]) == ("geometry", rank)
    assert summary["poses"]["position_only"] is positions_alone
    held_out = {level["name"]: level["held_out"]["mean_mm"] for level in summary["levels"]}
    assert held_out["geometry"] < 0.5 * held_out["registration"]
    judged = summary["judged"]
    assert judged["path"] == "a"
    assert judged["after"]["mean_mm"] < 0.75 * judged["before"]["mean_mm"]
    assert robots.load(str(out / "ur10_identified.urdf")).dof == 6


@pytest.mark.slow
def test_several_targets_are_columns_and_what_was_found_is_measured_with(tmp_path: Path) -> None:
    """Three targets a pose, placed nowhere; then one target's poses: run takes what was found."""
    truth = faulty_arm("rv_3sd_melfa", 3)
    folder, out = tmp_path / "targets", tmp_path / "out"
    rows = recorded(truth, "points", 80, 5e-5, 5, stated=False)
    write_session(folder, rows, robot="rv_3sd_melfa", period=10.0, positions_alone=True)
    for file in ("poses.csv", "encoders.csv"):  # nobody noted times: a reading a visit
        lines = (folder / file).read_text().splitlines()
        (folder / file).write_text("\n".join(line.partition(",")[2] for line in lines))
    toml = (folder / "session.toml").read_text()
    (folder / "session.toml").write_text(toml.replace("[clock]\nencoder_offset_s = 0.0\n", ""))
    free = ("--base", "free", "--splits", "2")
    done = verify("identify", folder, "-o", out, *free)
    assert done.status == 0, done.err
    summary = read_summary(out)
    assert (summary["rank"], len(summary["placements"])) == (33, 4)
    assert summary["recordings"] == {"count": 1, "scatter": None}
    for joint, true in enumerate(np.degrees(truth.correction)):
        found = summary["offsets"][joint]
        if found["add_to_reading_deg"] is not None:
            error = abs(found["add_to_reading_deg"] - true)
            assert error < 1.5 * found["expanded_uncertainty_deg"] < 0.05
    assert "column target" in verify("run", folder, "-o", tmp_path / "no").refusal
    rows = recorded(truth, "poses", 60, 5e-5, 6, stated=False)
    one = write_session(tmp_path / "one", rows, robot="rv_3sd_melfa", period=10.0)
    assert verify("identify", one, "-o", tmp_path / "two", *free).status == 0
    measured = verify("run", tmp_path / "two" / "sessions" / "one", "-o", tmp_path / "report")
    assert measured.status == 0, measured.err
    errors = [joint["mean_error_deg"] for joint in read_summary(tmp_path / "report")["joints"]]
    assert errors[0] is errors[5] is None  # hidden by base and tool, which are said to be "motion"
    assert np.abs(errors[1:5]).max() < 0.01


def test_a_linked_arm_s_offset_is_found_at_its_joint(tmp_path: Path) -> None:
    """Link 3 turns by q3 + q2; joint 2's encoder is off, and both links with it."""
    truth, second = true_arm("rv_3sd_melfa", 3, geometry=0.0, offsets=0.0), np.eye(6)[1]
    truth = replace(truth, world_T_base=np.eye(4), flange_T_target=np.eye(4))
    q = readings(truth.arm, 60, 1)
    poses, _ = measured(truth, q + np.eye(6)[2] * q[:, [1]], 1)
    rows = build_poses(q + np.radians(0.4) * second, poses)
    folder = write_session(tmp_path / "one", rows, robot="arm.toml", period=10.0)
    plain = (HERE / "rv_3sd_melfa.toml").read_text()
    before, joint_3 = plain.split("a_mm = 135.0")
    (folder / "arm.toml").write_text(f"{before}linkage = {{q2 = 1}}\na_mm = 135.0{joint_3}")
    assert verify("run", folder, "-o", tmp_path / "run", "--tolerance", "0.2").status == 1
    summary = read_summary(tmp_path / "run")
    errors = [joint["mean_error_deg"] for joint in summary["joints"]]
    assert np.allclose(errors, 0.4 * second, atol=0.02)
    assert [(c["joint"], c["kind"]) for c in summary["diagnosis"]] == [(2, "offset")]
    free = ("--base", "free", "--leds", "free", "--splits", "2")
    assert verify("identify", folder, "-o", tmp_path / "out", *free).status == 0
    offsets = [joint["error_deg"] for joint in read_summary(tmp_path / "out")["offsets"]]
    assert np.allclose(offsets[1:5], 0.4 * second[1:5], atol=0.02)
    (folder / "arm.toml").write_text(plain)
    for command in (("run",), ("identify", *free)):
        said = verify(*command, folder, "-o", tmp_path / "no").refusal
        assert "Add q2 to q3, or write linkage = {q2 = 1} at joint 3" in said


def test_unsuitable_sessions_are_refused_in_one_line(tmp_path: Path) -> None:
    one, other = SAMPLES / "multi_joint_fault_6r", SAMPLES / "multi_joint_rv_3sd"
    full = tmp_path / "full"
    full.mkdir()
    (full / "a").write_text("")
    copy = tmp_path / "copy"
    shutil.copytree(one, copy)
    with (copy / "session.toml").open("a") as file:
        file.write("\n[environment]\ntemperature_c = 23.0\n")
    for words, message in (
        ((tmp_path / "nowhere",), "nowhere"),
        ((one, one), "is given twice"),
        ((one, other), "one arm is identified at a time"),
        ((one, "--judge", one), "is given twice"),
        ((one, copy), "holds the same recording as"),
        ((one, "-o", full), "is not empty"),
        ((one, "--share", "0"), "0.05"),
        ((one, "--model", "all"), "geometry"),
    ):
        assert message in verify("identify", *words).refusal
        assert not (Path.cwd() / "multi_joint_fault_6r-identification").exists()


@pytest.mark.parametrize(
    ("spoil", "words", "message"),
    [
        ("quaternion", (), "the column qx reversed fits"),
        ("scale", (), "joint 5 scaled by 1.3 fits"),
        ("slip", (), "joint 3 slipped by +12° at about pose"),
        ("eccentricity", (), "joint 3 with eccentricity of 0."),
        ("backlash", (), "joint 3 with backlash of 0."),
        ("base", ("--base", "held"), "another base and target fit"),
        ("moved base", (), "the base moved by 4 mm and 0.2"),
        ("moved base", ("--base", "held"), "° at about pose 31 fits"),
        ("moved target", (), "the target moved by 3.6 mm and 0.0"),
    ],
)
def test_what_no_identification_can_describe_is_named(
    spoil: str, words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    """A joint's scale beside an encoder that is off by 10° as well; a base off by 3°."""
    truth = true_arm("iust_6r", 3, geometry=0.0, offsets=0.0)
    if spoil == "base":
        turn = rotation_exp(np.radians([2.0, 2.0, 0.0]))
        truth.world_T_base[:] = block_diag(turn, 1.0)
    q = readings(truth.arm, 60, 1)
    if spoil.startswith("moved"):  # 4.0 mm and 0.2°, or 3.6 mm, from pose 31 on
        truth.world_T_base[:] = np.eye(4)
    poses, _ = measured(replace(truth, flange_T_target=np.eye(4)), q, 1)
    if spoil == "moved base":
        turn = block_diag(rotation_exp(np.radians([0.2, 0.0, 0.0])), 1.0)
        poses[30:] = turn @ poses[30:]
        poses[30:, :3, 3] += [3e-3, -2e-3, 1.73e-3]
    elif spoil == "moved target":
        poses[30:, :3, 3] += poses[30:, :3, :3] @ [3e-3, 0.0, 2e-3]
    elif spoil == "scale":
        q = q * [1, 1, 1, 1, 1.3, 1] + np.radians(10) * np.eye(6)[2]
    elif spoil == "slip":
        q[30:, 2] += np.radians(12)
    elif spoil == "eccentricity":
        q[:, 2] += np.radians(0.5) * np.cos(q[:, 2] - 0.7)
    elif spoil == "backlash":
        q[1:, 2] += np.radians(0.25) * np.sign(np.diff(q[:, 2]))
    folder = write_session(tmp_path / "one", build_poses(q, poses), robot="iust_6r", period=10.0)
    if spoil == "quaternion":
        table = pd.read_csv(folder / "poses.csv")
        table.assign(qx=-table["qx"]).to_csv(folder / "poses.csv", index=False)
    free = ("--base", "free", "--leds", "free", "--splits", "2")
    assert message in verify("identify", folder, *(words or free), "-o", tmp_path / "no").refusal


def test_an_instrument_s_scale_is_told_to_be_in_all_lengths(tmp_path: Path) -> None:
    truth = true_arm("iust_6r", 3, geometry=0.0)
    q = readings(truth.arm, 60, 1)
    poses, _ = measured(truth, q, 1)
    poses[:, :3, 3] *= 1.001
    folder = write_session(tmp_path / "one", build_poses(q, poses), robot="iust_6r", period=10.0)
    done = verify("identify", folder, *FREE, "--model", "geometry", "-o", tmp_path / "out")
    assert "a scale that is off makes every length off by as much" in done.err
    longest = next(p for p in read_summary(tmp_path / "out")["parameters"] if p["name"] == "a_2")
    assert longest["change"] == pytest.approx(1e-3 * longest["nominal"], rel=0.2)  # so it is


@pytest.mark.parametrize("words", [(), ("--base", "free", "--leds", "free", "--splits", "2")])
def test_a_session_that_does_not_agree_with_the_others_is_named(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    """Joint 4 was 1° elsewhere on one day: neither the first session nor its base is to blame."""
    truth = true_arm("iust_6r", 3, geometry=0.0, offsets=0.0)
    truth = replace(truth, world_T_base=np.eye(4), flange_T_target=np.eye(4))
    folders = []
    for day in range(3):
        q = readings(truth.arm, 40, day)
        poses, _ = measured(truth, q, day)
        q = q + np.radians(1.0) * (day == 1) * np.eye(6)[3]
        rows = build_poses(q, poses)
        folders.append(write_session(tmp_path / f"day{day}", rows, robot="iust_6r", period=10.0))
    said = verify("identify", *folders, *words, "-o", tmp_path / "no").refusal
    assert f"{folders[1]}: does not agree with the other sessions: " in said
    both = verify("identify", *folders[:2], *words, "-o", tmp_path / "no").refusal
    assert f"does not agree with {folders[0]}: " in both or f"with {folders[1]}: " in both
    assert "Leave one of them out" in both


FREE = ("--base", "free", "--leds", "free", "--splits", "3")


def seen(
    name: str, seed: int, rows: Array | None = None, spoil: float = 0.0
) -> tuple[Array, Array]:
    """Readings and poses of an arm with errors of 0.3 mm and 0.3°; one is off by `spoil`, m."""
    truth = true_arm(name, seed)
    q = readings(truth.arm, 60, seed)
    poses, _ = measured(truth, q, seed)
    poses[10, :3, 3] += spoil
    return (q, poses) if rows is None else (q[rows], poses[rows])


def test_a_grossly_wrong_pose_is_listed_and_the_others_identify(tmp_path: Path) -> None:
    rows = build_poses(*seen("iust_6r", 5, spoil=5.0))
    folder = write_session(tmp_path / "one", rows, robot="iust_6r", period=10.0)
    done = verify("identify", folder, *FREE, "-o", tmp_path / "out")
    assert done.status == 0, done.err
    summary = read_summary(tmp_path / "out")
    assert [one["frame"] for one in summary["poses"]["outlying"]] == [10]
    true = -np.degrees(true_arm("iust_6r", 5).correction)
    for joint in range(1, 5):
        found = summary["offsets"][joint]
        assert abs(found["error_deg"] - true[joint]) < 4 * found["standard_uncertainty_deg"]


def test_another_arm_s_file_is_refused_though_its_links_could_be_bent_to_fit(
    tmp_path: Path,
) -> None:
    rows = build_poses(*seen("rv_3sd_melfa", 5))
    folder = write_session(tmp_path / "one", rows, robot="ur10", period=10.0)
    said = verify("identify", folder, *FREE, "-o", tmp_path / "no").refusal
    assert "only with offset_2 changed by" in said
    assert not (tmp_path / "no").exists()


def test_a_model_smaller_than_the_poses_call_for_is_warned_of(tmp_path: Path) -> None:
    folder = write_session(
        tmp_path / "one", build_poses(*seen("rv_3sd_melfa", 4)), robot="rv_3sd_melfa", period=10.0
    )
    done = verify("identify", folder, *FREE, "--model", "offsets", "-o", tmp_path / "out")
    assert "warning: --model offsets: 2." in done.err
    assert "offsets may be off by more than their U" in done.err


@pytest.mark.parametrize("count", [6, 7, 8, 9])
def test_few_poses_of_unknown_noise_call_for_no_geometry(count: int, tmp_path: Path) -> None:
    """As many positions as parameters are fitted exactly, and then show no noise at all."""
    for seed in range(4):
        rows = build_poses(*seen("iust_6r", seed, np.arange(count)))
        folder = write_session(tmp_path / f"{seed}", rows, robot="iust_6r", period=10.0)
        done = verify("identify", folder, *FREE, "-o", tmp_path / f"out{seed}")
        assert done.status == 0, done.err
        assert read_summary(tmp_path / f"out{seed}")["level"] != "geometry"


def test_poses_that_are_repeated_count_once(tmp_path: Path) -> None:
    """Twelve poses, each copied five times, say no more than the twelve; three say too little."""
    uncertainty = []
    for times in (1, 5):
        rows = build_poses(*seen("rv_3sd_melfa", 5, np.tile(np.arange(12), times)))
        folder = write_session(tmp_path / f"{times}", rows, robot="rv_3sd_melfa", period=10.0)
        out = tmp_path / f"out{times}"
        assert verify("identify", folder, *FREE, "--model", "geometry", "-o", out).status == 0
        offsets = read_summary(out)["offsets"][1:5]
        uncertainty.append([one["standard_uncertainty_deg"] for one in offsets])
    assert np.all(np.array(uncertainty[1]) > 0.8 * np.array(uncertainty[0]))
    rows = build_poses(*seen("iust_6r", 5, np.arange(60) % 3))
    folder = write_session(tmp_path / "three", rows, robot="iust_6r", period=10.0)
    said = verify("identify", folder, *FREE, "-o", tmp_path / "no").refusal
    assert "3 different postures with readings" in said
