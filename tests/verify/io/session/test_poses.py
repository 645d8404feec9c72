"""Sessions of poses: what was measured through pictures comes out of a file of poses alike."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import robots
from reports import Results, render_html
from tests.support.posed import Watched, encoders_csv, poses_csv, write_posed
from tests.support.recorded import refusal, replace
from verify.analysis.session import analyse
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.session import open_session

SAMPLE = Path(__file__).parents[4] / "sample_sessions" / "multi_joint_fault_6r"
TOLERANCE = "\n[tolerance]\njoints_deg = 0.2\n"
ZEROS = "y_mm = 0, z_mm = 0, rx_deg = 0, ry_deg = 0, rz_deg = 0"
BODY = f"body_standard_uncertainty = {{x_mm = -1, {ZEROS}}}"
CLOCK = "\n[clock]\nencoder_offset_s = 0.085\n"


@pytest.fixture(scope="module")
def watched() -> Watched:
    """The sample (an offset of 0.35° on joint 2, a clock 0.085 s off) through its pictures."""
    return Watched(open_session(SAMPLE))


@pytest.fixture(scope="module")
def seen(watched: Watched) -> Results:
    return watched.analyse()


def posed(
    folder: Path,
    watched: Watched,
    more: str = TOLERANCE,
    frame: str = "rig",
    *,
    positions_alone: bool = False,
) -> Path:
    t, poses = watched.poses
    text = poses_csv(t, poses, positions_alone=positions_alone)
    return write_posed(folder / "posed", SAMPLE, text, frame=frame, more=more)


def analyse_own(folder: Path, t: Array, q: Array, poses: Array, more: str = "") -> Results:
    """Analyse poses and readings of one's own, in the robot's base, by one clock."""
    more += "\n[clock]\nencoder_offset_s = 0\n"
    text, read = poses_csv(t, poses), encoders_csv(t, q)
    write_posed(folder, SAMPLE, text, frame="robot_base", more=more, encoders=read)
    return analyse(open_session(folder))


def joints(results: Results, key: str) -> list[Any]:
    return [joint[key] for joint in results.summary["joints"]]


def measured(results: Results, what: str = "measured") -> Array:
    """A figure of each pair and joint, (n, 6), degrees."""
    return results.tables["frames"][[f"q{j}_{what}_deg" for j in range(1, 7)]].to_numpy()


def test_the_file_gives_the_joints_that_the_pictures_gave(
    watched: Watched, seen: Results, tmp_path: Path
) -> None:
    results = analyse(open_session(posed(tmp_path, watched)))
    # 1e-6 mm and 1e-9 of a quaternion, a metre of arm, a wrist a few degrees off its singularity
    np.testing.assert_allclose(measured(results), measured(seen), rtol=0, atol=5e-6)
    assert results.summary["pairs"] == seen.summary["pairs"]
    assert results.summary["verdict"] == seen.summary["verdict"] == "nonconform"
    assert joints(results, "verdict") == joints(seen, "verdict")
    # weights differ: the pictures know each pair's covariance, the file states none
    clock, other = results.summary["clock"], seen.summary["clock"]
    off = clock["encoder_offset_s"] - other["encoder_offset_s"]
    assert abs(off) < 2 * other["standard_uncertainty_s"]
    assert clock["source"] == "estimated"
    assert results.summary["session"]["instrument"] == "a laser tracker"
    assert results.setup["instrument"]["name"] == "a laser tracker"
    line = "Measured by another instrument, not by cameras: a laser tracker"
    assert results.summary["warnings"][0].startswith(f"{line}, 60 poses.")
    assert line in render_html(results)
    assert results.images == {}
    assert len(results.tables["spots"]) == 0
    assert "pixels" not in set(results.tables["budget"]["source"])


def test_with_one_clock_the_plain_means_agree_to_the_files_rounding(
    watched: Watched, seen: Results, tmp_path: Path
) -> None:
    offset = seen.summary["clock"]["encoder_offset_s"]
    more = f"\n[clock]\nencoder_offset_s = {offset!r}\n"
    results = analyse(open_session(posed(tmp_path, watched, more)))
    np.testing.assert_allclose(
        joints(results, "plain_mean_error_deg"),
        joints(seen, "plain_mean_error_deg"),
        rtol=0,
        atol=5e-6,
    )


def test_poses_in_the_base_or_in_the_instruments_own_frame_are_the_same_session(
    watched: Watched, tmp_path: Path
) -> None:
    t, poses = watched.poses
    rig_T_base = watched.session.rig.rig_T_base
    flange_T_body = np.eye(4)
    flange_T_body[:3, :3] = Rotation.from_rotvec([0.3, -1.1, 0.5]).as_matrix()
    flange_T_body[:3, 3] = [0.02, -0.05, 0.109]
    body = (
        f"point_mm = {(flange_T_body[:3, 3] * 1e3).tolist()}\n"
        f"rotation = {flange_T_body[:3, :3].tolist()}\n"
    )
    base = (
        f'\n[robot_base]\nsource = "fixture"\nrotation = {rig_T_base[:3, :3].tolist()}\n'
        f"position_mm = {(rig_T_base[:3, 3] * 1e3).tolist()}\n"
    )
    given = {
        "robot_base": (np.linalg.inv(rig_T_base) @ poses, ""),
        "instrument": (poses @ flange_T_body, body + base),
    }
    results = []
    for frame, (written, more) in given.items():
        folder = tmp_path / frame
        write_posed(folder, SAMPLE, poses_csv(t, written), frame=frame, more=more + CLOCK)
        results.append(analyse(open_session(folder)))
    np.testing.assert_allclose(measured(results[0]), measured(results[1]), rtol=0, atol=1e-5)


def test_stated_uncertainties_of_base_and_body_enter_as_through_pictures(
    watched: Watched, tmp_path: Path
) -> None:
    t, poses = watched.poses
    # joint 1 turns about the base's z: an unknown turn of the base about it is its offset's doubt,
    # and joint 6 about the flange's
    more = (
        "body_standard_uncertainty = {x_mm=0, y_mm=0, z_mm=0, rx_deg=0, ry_deg=0, rz_deg=0.07}\n"
        '\n[covariance]\nparameters = ["robot_base.rz_deg"]\nstandard_uncertainty = [0.05]\n'
        f"correlation = [[1.0]]\n{CLOCK}"
    )
    base_T_flange = np.linalg.inv(watched.session.rig.rig_T_base) @ poses
    text = poses_csv(t, base_T_flange)
    folder = write_posed(tmp_path / "posed", SAMPLE, text, frame="robot_base", more=more)
    results = analyse(open_session(folder))
    u = joints(results, "standard_uncertainty_deg")
    assert u[0] == pytest.approx(0.05, rel=0.01)
    assert u[5] == pytest.approx(0.07, rel=0.01)
    assert max(u[1:5]) < 0.01
    uncounted = results.summary["budget"]["uncounted"]
    assert "robot base" not in uncounted
    assert "the body on the flange" not in uncounted
    assert "the instrument's own calibration" in uncounted


def test_scatter_that_is_not_stated_is_found_in_the_data(watched: Watched, tmp_path: Path) -> None:
    # 200 poses a joint's own noise of 0 would drown nothing of: readings of the model itself
    arm, rng = watched.session.arm, np.random.default_rng(8)
    t = np.arange(200, dtype=np.float64) * 0.05
    phase = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    q = np.deg2rad([20, -60, 40, 5, -80, 20] + 15 * np.sin(0.8 * t[:, None] + phase))
    poses = robots.forward(arm, q)
    poses[:, :3, 3] += rng.normal(0, 0.2e-3, (200, 3))
    turns = Rotation.from_rotvec(rng.normal(0, np.deg2rad(0.03), (200, 3)))
    poses[:, :3, :3] = turns.as_matrix() @ poses[:, :3, :3]
    found = analyse_own(tmp_path / "posed", t, q, poses)
    stated = "position_standard_uncertainty_mm = 0.2\norientation_standard_uncertainty_deg = 0.03\n"
    known = analyse_own(tmp_path / "stated", t, q, poses, stated)
    ratio = measured(found, "u") / measured(known, "u")
    assert ((ratio > 0.8) & (ratio < 1.25)).all()
    assert "the instrument's noise" not in known.summary["budget"]["uncounted"]


@pytest.mark.parametrize("count", [8, 40])
def test_noise_of_visits_is_what_a_model_of_all_causes_leaves(
    count: int, watched: Watched, tmp_path: Path
) -> None:
    """The arm has an offset of 0.5°; of a handful of visits nothing tells the noise."""
    rng, low = np.random.default_rng(4), np.array([0, -80, 20, -20, -100, 0])
    q = np.deg2rad(rng.uniform(low, low + 40, (count, 6)))
    true = q - np.deg2rad([0, 0.5, 0, 0, 0, 0])
    poses = robots.forward(watched.session.arm, true)
    poses[:, :3, 3] += rng.normal(0, 0.2e-3, (count, 3))
    poses[:, :3, :3] = (
        Rotation.from_rotvec(rng.normal(0, 5e-4, (count, 3))).as_matrix() @ (poses[:, :3, :3])
    )
    t = np.arange(count, dtype=np.float64) * 10
    results = analyse_own(tmp_path / "posed", t, q, poses)
    named = any("the instrument's noise" in warning for warning in results.summary["warnings"])
    assert named is (count == 8)
    if count == 40:
        more = "position_standard_uncertainty_mm = 0.2\n"
        more += "orientation_standard_uncertainty_deg = 0.0286\n"
        known = analyse_own(tmp_path / "stated", t, q, poses, more)
        ratio = measured(results, "u") / measured(known, "u")
        assert ((ratio > 0.75) & (ratio < 1.3)).all()


def test_of_positions_alone_three_directions_are_determined(
    watched: Watched, seen: Results, tmp_path: Path
) -> None:
    folder = posed(tmp_path, watched, f"point_mm = [0, 0, 0]\n{CLOCK}", positions_alone=True)
    results = analyse(open_session(folder))
    summary, frames = results.summary, results.tables["frames"]
    assert summary["known_dof"] == 3
    assert (frames["known_dof"] == 3).all()
    # the flange's position cannot show joint 6, which turns about an axis through it: whatever it
    # reads. Joints that the open turn moves stay empty a pair; joint 2's offset is still found.
    assert frames[["q6_measured_deg", "rx_deg"]].isna().all().all()
    assert summary["joints"][5]["mean_error_deg"] is None
    second = summary["joints"][1]
    assert abs(second["mean_error_deg"] - joints(seen, "mean_error_deg")[1]) < (
        second["expanded_uncertainty_deg"] + 0.002
    )
    assert any("only 3 of 6" in warning for warning in summary["warnings"])


def test_a_point_off_the_flange_determines_its_motion(watched: Watched, tmp_path: Path) -> None:
    t, poses = watched.poses
    point = np.array([0.06, 0.005, 0.02])
    moved = poses.copy()
    moved[:, :3, 3] += poses[:, :3, :3] @ point
    more = f"point_mm = {(point * 1e3).tolist()}\nposition_standard_uncertainty_mm = 0.02\n"
    text = poses_csv(t, moved, positions_alone=True)
    session = open_session(write_posed(tmp_path / "posed", SAMPLE, text, more=more + CLOCK))
    summary = analyse(session).summary
    # 60 mm off joint 6's axis: its offset moves the point, and shows
    assert summary["joints"][5]["mean_error_deg"] is not None
    assert [(c["joint"], c["kind"]) for c in summary["diagnosis"]] == [(2, "offset")]


@pytest.mark.parametrize(
    ("metres", "order", "message"),
    [
        (True, range(8), r"poses\.csv: .* an export in metres fits"),
        (False, [0, 1, 2, 3, 5, 6, 7, 4], "whose scalar comes last fits"),
    ],
)
def test_metres_and_a_scalar_that_comes_last_are_refused(
    watched: Watched, tmp_path: Path, metres: bool, order: list[int], message: str
) -> None:
    t, poses = watched.poses
    poses = poses.copy()
    poses[:, :3, 3] *= 1e-3 if metres else 1.0
    header, *rows = (row.split(",") for row in poses_csv(t, poses).splitlines())
    lines = [header, *([row[i] for i in order] for row in rows)]
    text = "\n".join(",".join(line) for line in lines) + "\n"
    with pytest.raises(InputError, match=message):
        analyse(open_session(write_posed(tmp_path / "posed", SAMPLE, text)))


def test_cameras_cannot_be_watched_by_poses(watched: Watched, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds poses and no pictures"):
        next(open_session(posed(tmp_path, watched)).pairs())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('frame = "rig"', 'frame = "world"', 'poses.frame: is "world"'),
        ('instrument = "a laser tracker"', 'instrument = " "', "poses.instrument: is empty"),
        ('frame = "rig"', 'frame = "robot_base"', 'rig: is given; poses in the frame "robot_base"'),
        ('rig = "rig.toml"', "", "rig: is missing"),
        ('rig = "rig.toml"', 'left = "left.mkv"\nrig = "rig.toml"', "left: stands beside [poses]"),
        ('file = "poses.csv"', 'file = "track.csv"', "poses.file: names"),
        ('frame = "rig"', 'frame = "rig"\nsource = "guess"', 'poses.source: is "guess"'),
        (
            'frame = "rig"',
            'frame = "rig"\nposition_standard_uncertainty_mm = 0',
            "a standard uncertainty is positive",
        ),
        (
            'frame = "rig"',
            'frame = "rig"\nrotation = [[2,0,0],[0,1,0],[0,0,1]]',
            "poses.rotation: is not a rotation",
        ),
        ('frame = "rig"', f'frame = "rig"\n{BODY}', "poses.body_standard_uncertainty.x_mm: is -1"),
        ('[poses]\nfile = "poses.csv"', 'poses = "poses.csv"\n[x]', "poses: is"),
    ],
)
def test_a_wrong_session_file_is_refused_in_one_line(
    watched: Watched, tmp_path: Path, old: str, new: str, message: str
) -> None:
    folder = posed(tmp_path, watched)
    replace(folder / "session.toml", old, new)
    assert message in str(refusal(open_session, folder))


def test_the_documents_example_is_read_without_a_complaint(tmp_path: Path) -> None:
    text = (SAMPLE.parents[1] / "docs" / "session.md").read_text()
    text = text[text.index("## Poses of another instrument") :]
    toml = text[text.index("```toml\n") + 8 :].partition("```")[0]
    series = text[text.index("```\nt_s,") + 4 :].partition("```")[0]
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / "session.toml").write_text(toml)
    (folder / "poses.csv").write_text(series)
    (folder / "encoders.csv").write_text((SAMPLE / "encoders.csv").read_text())
    session = open_session(folder)
    assert session.instrument is not None
    assert len(session.warnings) == 1  # whose poses they are
    assert session.warnings[0].startswith("Measured by another instrument")


def test_doubts_of_cameras_have_no_place_beside_poses(watched: Watched, tmp_path: Path) -> None:
    more = (
        '\n[covariance]\nparameters = ["left.fx_px"]\nstandard_uncertainty = [0.3]\n'
        "correlation = [[1.0]]\n"
    )
    folder = posed(tmp_path, watched, more, "robot_base")
    with pytest.raises(InputError, match=r'covariance\.parameters\[0\]: is "left\.fx_px"'):
        open_session(folder)


def test_visits_that_nobody_timed_are_compared_row_by_row(tmp_path: Path) -> None:
    """Joint 3 reads 0.5° too much, more from visit to visit: an order, and no drift an hour."""
    arm, rng = robots.load("iust_6r"), np.random.default_rng(4)
    q = np.deg2rad(np.array([20, -50, 60, 10, -70, 20]) + rng.uniform(-20, 20, (40, 6)))
    text = poses_csv(np.arange(40.0), robots.forward(arm, q))
    q[:, 2] += np.deg2rad(np.linspace(0.4, 0.6, 40))
    read = encoders_csv(np.arange(40.0), q)
    folder = write_posed(tmp_path / "visits", SAMPLE, text, frame="robot_base", encoders=read)
    for name in ("poses.csv", "encoders.csv"):
        text = (folder / name).read_text()
        (folder / name).write_text("".join(row.split(",", 1)[1] for row in text.splitlines(True)))
    results = analyse(open_session(folder))
    assert results.table("frames")["t_s"].isna().all()
    assert results.summary["clock"]["alternatives_s"] == []
    assert results.summary["joints"][2]["mean_error_deg"] == pytest.approx(0.5, abs=0.02)
    assert not {c["kind"] for c in results.summary["diagnosis"]} & {"drift", "clock_drift", "step"}
    assert "pose, in order" in render_html(results)
    (folder / "session.toml").write_text((folder / "session.toml").read_text() + CLOCK)
    with pytest.raises(InputError, match="clock: is given; readings without times have no clock"):
        open_session(folder)
