"""`verify calibrate register` on a tracker's poses: base and target, and what runs with them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robots.transforms import difference, invert
from tests.support.command import read_summary, verify
from tests.support.published import write_session
from tests.support.true_arm import TrueArm, measured, readings, true_arm
from verify.calibration.kinematics.placements import target_in_flange
from verify.calibration.kinematics.poses import build_poses
from verify.calibration.kinematics.registration import PosesRegistration, register_poses
from verify.calibration.kinematics.sessions import gather_sessions, session_to_poses
from verify.core.records import Array
from verify.io.session.session import Session, open_poses, open_session

ROBOT = "rv_3sd_melfa"
TRUTH = true_arm(ROBOT, 3, geometry=0.0, offsets=0.0)
NOISE = "position_standard_uncertainty_mm = 0.1\n"
TURNS = "orientation_standard_uncertainty_deg = 0.05\n"


def tracker(
    folder: Path, seed: int, *, truth: TrueArm = TRUTH, offset: Array | float = 0.0, **more: bool
) -> Path:
    """A session as a tracker gives it: nobody says where base and target are."""
    q = readings(truth.arm, 40, seed)
    rows = build_poses(q + offset, measured(truth, q, seed)[0])
    write_session(folder, rows, robot=ROBOT, period=10.0, **more)
    text = (folder / "session.toml").read_text()
    text = text.replace('frame = "robot_base"', 'frame = "instrument"')
    turns = "" if more.get("positions_alone") else TURNS
    (folder / "session.toml").write_text(text + NOISE + turns)
    return folder


@pytest.mark.parametrize("alone", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_base_and_target_are_found_within_their_uncertainty_and_run_with(
    alone: bool, tmp_path: Path
) -> None:
    session, out = tracker(tmp_path / "day", 5, positions_alone=alone), tmp_path / "registered"
    assert "calibrate register" in verify("run", session, "-o", tmp_path / "no").refusal
    report = tmp_path / "report"
    done = verify("calibrate", "register", session, "-o", out, "--report", report)
    assert done.status == 0, done.err
    assert "joints 1 and 6 that was there already cannot show" in done.out
    found = open_session(out)
    error = difference(found.rig.rig_T_base[None], TRUTH.world_T_base[None])[0]
    error *= [1e3] * 3 + [180 / np.pi] * 3
    u = found.rig.covariance.standard_uncertainty
    assert (np.abs(error) < 3.5 * u).all(), (error, u)
    assert (u < [0.2, 0.2, 0.2, 0.05, 0.05, 0.05]).all()
    point = found.instrument.flange_T_body[:3, 3] - TRUTH.flange_T_target[:3, 3]
    assert (np.abs(point) < 3.5 * found.marker.body_standard_uncertainty[:3]).all()
    assert (found.rig.base_source, found.marker.source) == ("motion", "motion")
    summary = read_summary(report)
    assert (summary["kind"], summary["method"]) == ("registration", "poses")
    assert "Target in the flange frame" in (report / "report.html").read_text()
    assert verify("report", report).status == 0
    run = verify("run", out, "-o", tmp_path / "run")
    assert run.status == 0, run.err
    for joint in read_summary(tmp_path / "run")["joints"][1:5]:
        assert abs(joint["mean_error_deg"]) < 1.5 * joint["expanded_uncertainty_deg"] < 0.1


@pytest.mark.slow
def test_register_identify_and_run_on_what_was_identified(tmp_path: Path) -> None:
    truth = replace(TRUTH, correction=np.radians([0.0, -0.4, 0.0, 0.25, 0.0, 0.0]))
    session, out = tracker(tmp_path / "day", 7, truth=truth), tmp_path / "registered"
    report = ("--report", tmp_path / "report")
    assert verify("calibrate", "register", session, "-o", out, *report).status == 0
    words = ("-o", tmp_path / "arm", "--splits", "2", "--model", "offsets")
    assert verify("identify", out, *words).status == 0
    offsets = read_summary(tmp_path / "arm")["offsets"]
    for joint, true in ((1, -0.4), (3, 0.25)):
        found, u = (offsets[joint][k] for k in ("add_to_reading_deg", "expanded_uncertainty_deg"))
        assert abs(found - true) < 1.5 * u < 0.1
    run = verify("run", tmp_path / "arm" / "sessions" / "registered", "-o", tmp_path / "run")
    assert run.status == 0, run.err
    assert abs(read_summary(tmp_path / "run")["joints"][1]["mean_error_deg"]) < 0.03


@pytest.mark.slow
def test_a_later_session_takes_the_registration_and_shows_a_new_offset(tmp_path: Path) -> None:
    first, out = tracker(tmp_path / "first", 5), tmp_path / "registered"
    report = ("--report", tmp_path / "report")
    assert verify("calibrate", "register", first, "-o", out, *report).status == 0
    high = np.radians([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])
    later = tracker(tmp_path / "later", 15, offset=high)
    words = ("--rig", out, "--tolerance", "0.2", "-o", tmp_path / "run")
    assert verify("run", later, *words).status == 1
    joint = read_summary(tmp_path / "run")["joints"][2]
    assert joint["verdict"] == "nonconform"
    assert abs(joint["mean_error_deg"] - 0.3) < 1.5 * joint["expanded_uncertainty_deg"] < 0.05
    assert str(out / "session.toml") in read_summary(tmp_path / "run")["inputs"]
    assert "--marker" in verify("run", later, "--marker", out).refusal
    assert "no such file" in verify("run", later, "--rig", tmp_path / "none").refusal


def registered(session: Session) -> PosesRegistration:
    rows = session_to_poses(session, lambda *_: None, registered=False)
    return register_poses(gather_sessions([rows]))


def test_a_session_that_begins_with_a_byte_order_mark_is_registered(tmp_path: Path) -> None:
    path = tracker(tmp_path / "day", 5) / "session.toml"
    path.write_text(path.read_text(), encoding="utf-8-sig")
    session = open_poses(path.parent)
    assert session is not None
    assert registered(session).text.startswith(b"format = 1")


def test_absorption_is_what_base_and_target_move_with_an_offset(tmp_path: Path) -> None:
    """Registered again with a joint that reads 0.1° higher: they move by -G times that."""
    session = open_poses(tracker(tmp_path / "day", 5))
    assert session is not None
    plain, high = registered(session), np.radians(0.1)
    for joint in (0, 3, 4, 5):
        q = session.encoders.q.copy()
        q[:, joint] += high
        moved = registered(replace(session, encoders=replace(session.encoders, q=q)))
        base = difference(moved.rig.rig_T_base[None], plain.rig.rig_T_base[None])[0]
        targets = [target_in_flange(session, one.fit) for one in (moved, plain)]
        body = targets[0] @ invert(targets[1])
        turn = Rotation.from_matrix(body[:3, :3]).as_rotvec()
        change = np.concatenate([base, body[:3, 3], turn]) / high
        np.testing.assert_allclose(change, -plain.rig.absorption[:, joint], atol=0.03)


def test_what_no_base_and_target_explain_is_refused(tmp_path: Path) -> None:
    def refusal(folder: Path, *words: str) -> str:
        return verify("calibrate", "register", folder, "-o", tmp_path / "out", *words).refusal

    session = tracker(tmp_path / "day", 5)
    assert "--keep-base" in refusal(session, "--keep-base")
    assert "--keep-leds" in refusal(session, "--keep-leds")
    assert "--marker" in refusal(session, "--marker", "m.toml")
    assert "--rig" in refusal(session, "--rig", "rig.toml")
    q = np.tile(readings(TRUTH.arm, 1, 2), (30, 1))
    q[:, 0] += np.linspace(-0.5, 0.5, 30)
    rows = build_poses(q, measured(TRUTH, q, 3)[0])
    one = write_session(tmp_path / "one", rows, robot=ROBOT, period=10.0)
    assert "undetermined" in refusal(one)
    other = tracker(tmp_path / "other", 6)
    lines = (other / "encoders.csv").read_text().splitlines()
    shuffled = [lines[0]] + [
        f"{own.partition(',')[0]},{another.partition(',')[2]}"
        for own, another in zip(lines[1:], reversed(lines[1:]), strict=True)
    ]
    (other / "encoders.csv").write_text("\n".join([*shuffled, ""]))
    assert "mm (rms) of the poses are left" in refusal(other)
    assert not (tmp_path / "out").exists()


def test_three_postures_again_and_again_are_three(tmp_path: Path) -> None:
    """Base and target fit three places exactly: nothing is left that could show the noise."""
    q = readings(TRUTH.arm, 3, 1)[np.arange(60) % 3]
    rows = build_poses(q, measured(TRUTH, q, 1)[0])
    session = write_session(tmp_path / "day", rows, robot=ROBOT, period=10.0)
    said = verify("calibrate", "register", session, "-o", tmp_path / "no").refusal
    assert "3 different postures with readings; 6 at least" in said
