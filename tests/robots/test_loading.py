"""Robots by name and by path; errors of a file in one line."""

import hashlib
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from numpy.testing import assert_allclose

import robots
from robots.library import HERE, example

GOOD = (HERE / "iust_6r.toml").read_text(encoding="utf-8")
URDF = """<robot name="arm"><link name="base"/><link name="one"/><link name="two"/>
<link name="tip"/>
<joint name="a" type="{a}"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="2" effort="1" velocity="1"/></joint>
<joint name="b" type="{b}"><parent link="one"/><child link="two"/><origin xyz="0.5 0 0"/>
  <axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="1" velocity="1"/>{mimic}</joint>
<joint name="c" type="fixed"><parent link="two"/><child link="tip"/><origin xyz="0 0 0.3"/></joint>
</robot>"""


def urdf(folder: Path, a: str = "revolute", b: str = "revolute", mimic: str = "") -> Path:
    path = folder / "arm.urdf"
    path.write_text(URDF.format(a=a, b=b, mimic=mimic), encoding="utf-8")
    return path


def complaint(name: str, base: str | None = None, tip: str | None = None) -> str:
    with pytest.raises(robots.RobotError) as caught:
        robots.load(name, base=base, tip=tip)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.place
    return message


def test_the_printed_limits_stand_in_the_files() -> None:
    printed = [(-170, 170), (-90, 135), (-20, 171), (-160, 160), (-120, 120), (-360, 360)]
    for name in ("rv_3sd", "rv_3sd_melfa"):
        arm = robots.load(name)
        assert_allclose(np.degrees([arm.lower, arm.upper]).T, printed)
    elbow_up = robots.load("rv_3sd_melfa")
    assert_allclose(np.degrees(elbow_up.theta(elbow_up.lower))[1:3], [-180, -110])
    assert_allclose(np.degrees(elbow_up.theta(elbow_up.upper))[1:3], [45, 81])
    six = robots.load("iust_6r")
    assert_allclose(np.degrees([six.lower, six.upper]), [[-170] * 6, [170] * 6])
    assert "no joint limits" in six.source


def test_an_unknown_name_is_answered_with_the_nearest_and_all_known() -> None:
    message = complaint("iust_5r")
    assert 'did you mean "iust_6r"?' in message
    assert "rv_3sd_melfa" in message
    assert "ur5" in message
    assert robots.load("IUST 6R").fingerprint == robots.load("iust_6r").fingerprint
    assert "\\n" in complaint("x\n\x1b[31m")  # a name cannot break the line


def test_a_path_is_of_a_robot_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD, encoding="utf-8")
    arm = robots.load(str(tmp_path / "mine.toml"))
    assert arm.name == "iust_6r"
    assert arm.fingerprint == hashlib.sha256(GOOD.encode()).hexdigest()
    assert "mine.toml" in complaint("mine.toml")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("a_mm = 36.5", "a_m = 36.5", ["joint 1, a_m", "unknown key", 'Did you mean "a_mm"?']),
        ("a_mm = 36.5", 'a_mm = "36.5"', ["joint 1, a_mm", "'36.5'", "a number is needed"]),
        ("a_mm = 36.5", f"a_mm = {'9' * 400}", ["joint 1, a_mm", "at most 1e+06", "Correct it"]),
        ("a_mm = 36.5", f"a_mm = {'9' * 5000}", ["not valid TOML", "Correct that line."]),
        ("a_mm = 36.5", "a_mm = nan", ["joint 1, a_mm", "nan", "a number"]),
        ("a_mm = 36.5", "a_mm = true", ["joint 1, a_mm", "True", "a number"]),
        ("a_mm = 36.5 ", "", ["joint 1, a_mm", "missing"]),
        ("a_mm = 251.5", "a_mm = 0", ["joint 2, a_mm", "longer than 0"]),
        ("a_mm = 0.0", "a_mm = 5", ["joint 5, a_mm", "5; 0 is needed", "parallel_axes"]),
        ("alpha_deg = 90.0", "alpha_deg = 89", ["joint 4, alpha_deg", "89; 90 is needed"]),
        ("[-170.0, 170.0]", "[170.0, -170.0]", ["joint 1, limits_deg", "lower one first"]),
        ("[-170.0, 170.0]", "[1]", ["joint 1, limits_deg", "[1]", "two numbers"]),
        ("limits_deg", "sign = 2\nlimits_deg", ["joint 1, sign", "1 or -1"]),
        ("limits_deg", "linkage = {q1 = 1}\nlimits_deg", ["joint 1, linkage", "{q2 = 1}"]),
        ("limits_deg", "speed_deg_s = 0\nlimits_deg", ["joint 1, speed_deg_s", "0", "above 0"]),
        ("limits_deg", "speed_deg_s = 9\nlimits_deg", ["joint 2, speed_deg_s", "for all joints"]),
        ("limits_deg", "jerk_deg_s3 = nan\nlimits_deg", ["joint 1, jerk_deg_s3", "above 0"]),
        ('"parallel_axes"', '"parallel_axis"', ["family", 'Did you mean "parallel_axes"?']),
        ('"parallel_axes"', '"spherical_wrist"', ["joint 4, a_mm", "92; 0 is needed"]),
        ("format = 1", "format = 2", ["format", "2", "reads 1"]),
        ("format = 1", "format = 1\ncolour = 1", ["colour", "unknown key", "Remove it"]),
        ("format = 1", "format = ", ["not valid TOML", "line 1"]),
        ("a_mm = 36.5", "x = {" + '"a".' * 20_000 + "b = 1}", ["is nested too deeply"]),
        ("[[joint]]", "[[joint]]\na_mm = 1\n[[joint]]", ["7 joints", "6", "URDF"]),
    ],
)
def test_a_mistake_in_a_robot_file_is_named(
    tmp_path: Path, old: str, new: str, words: list[str]
) -> None:
    assert old in GOOD
    path = tmp_path / "bad.toml"
    path.write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    message = complaint(str(path))
    assert message.startswith(str(path))
    for word in words:
        assert word in message


def test_a_robot_file_may_begin_with_the_mark_that_windows_writes(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(GOOD, encoding="utf-8-sig")
    assert_allclose(robots.load(str(tmp_path / "mine.toml")).a, robots.load("iust_6r").a)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("", '<?xml version="1.0" encoding="nonsense"?>', ["not valid XML", "UTF-8"]),
        ("", '<?xml version="1.0" encoding="shift_jis"?>', ["not valid XML", "UTF-8"]),
        ("0 0 1", "0 0 0", ['joint "a", axis', "has no length"]),
    ],
)
@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_a_urdf_in_an_unknown_encoding_or_with_an_axis_of_no_length_is_refused(
    tmp_path: Path, kind: str, old: str, new: str, words: list[str]
) -> None:
    path = urdf(tmp_path, kind, kind)
    assert robots.load(str(path)).dof == 2
    path.write_text(path.read_text(encoding="utf-8").replace(old, new, 1), encoding="utf-8")
    message = complaint(str(path))
    assert [word for word in words if word not in message] == [], message


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = tmp_path / "latin.toml"
    path.write_bytes(b'format = 1\nname = "\xe9"')
    assert "not UTF-8" in complaint(str(path))
    for name in ("none.toml", "none.urdf"):
        assert "No such file" in complaint(str(tmp_path / name))
    path.write_text('joint = 3\nformat = 1\nname="x"\nfamily="x"\ndescription="x"\nsource="x"')
    assert "[[joint]] six times" in complaint(str(path))


def test_links_of_a_dh_arm_cannot_be_named() -> None:
    assert "only a URDF has links" in complaint("iust_6r", base="base")
    assert "only a URDF has links" in complaint("IUST 6R", base="base")


def test_a_urdfs_links_can_be_named_however_the_arm_is_spelled() -> None:
    arm = robots.load("UR-5", base="base_link", tip="tool0")
    assert arm.fingerprint == robots.load("ur5", base="base_link", tip="tool0").fingerprint
    assert arm.name == "ur5"


@pytest.mark.parametrize(
    ("name", "base", "tip", "dof"),
    [
        ("ur5", "world", "tool0", 6),
        ("panda", "panda_link0", "panda_hand_tcp", 7),
        ("xarm7", "world", "link_eef", 7),
        ("kinova", "base", "j2s6s200_end_effector", 6),
        ("z1", "world", "link06", 6),
    ],
)
def test_a_known_urdf_ends_before_its_gripper(name: str, base: str, tip: str, dof: int) -> None:
    arm = robots.load(name)
    assert (arm.base, arm.tip, arm.dof) == (base, tip, dof)
    assert arm.model.nv == dof
    assert np.isfinite([arm.lower, arm.upper]).all()
    assert (arm.lower < arm.upper).all()


@pytest.mark.parametrize("name", [*robots.names(), *robots.example_names()])
def test_every_arm_loads_and_passes_its_check(name: str) -> None:
    arm = robots.load(name)
    check = robots.self_check(arm, poses=200 if name in (*robots.names(), "ur5") else 20)
    assert max(check.inverse_position, check.inverse_rotation) < 1e-9
    assert check.difference_jacobian < 2e-9
    if name in (*robots.names(), "ur5"):
        assert check.lost == 0
    assert max(check.pinocchio_position, check.pinocchio_rotation) < 1e-14
    assert check.pinocchio_jacobian < 1e-14


def test_a_urdfs_flange_is_pinocchios_between_any_two_links() -> None:
    path = example("panda_description/urdf/panda.urdf")
    arm = robots.load(str(path), base="panda_link1", tip="panda_link8")
    whole = pinocchio.buildModelFromUrdf(str(path))
    data = whole.createData()
    base, tip = whole.getFrameId("panda_link1"), whole.getFrameId("panda_link8")
    assert arm.dof == 6
    for q in np.random.default_rng(1).uniform(arm.lower, arm.upper, (20, 6)):
        pinocchio.framesForwardKinematics(whole, data, np.array([0.7, *q, 0.01, 0.01]))
        expected = data.oMf[base].actInv(data.oMf[tip]).homogeneous
        assert_allclose(robots.forward(arm, q), expected, atol=1e-14)


def test_a_small_urdf_agrees_with_trigonometry_and_a_continuous_joint_has_two_turns(
    tmp_path: Path,
) -> None:
    bounded = robots.load(str(urdf(tmp_path)))
    assert_allclose([bounded.lower, bounded.upper], [[-1, -1], [2, 2]])
    q = turn, lift = np.array([0.4, 0.7])
    out = 0.5 + 0.3 * np.sin(lift)
    flange = robots.forward(bounded, q)[:3, 3]
    assert_allclose(flange, [out * np.cos(turn), out * np.sin(turn), 0.3 * np.cos(lift)])
    arm = robots.load(str(urdf(tmp_path, a="continuous")))
    assert_allclose([arm.lower[0], arm.upper[0]], [-2 * np.pi, 2 * np.pi])
    assert_allclose(robots.forward(arm, q), robots.forward(bounded, q), atol=1e-15)
    assert_allclose(robots.jacobian(arm, q), robots.jacobian(bounded, q), atol=1e-15)


def test_a_joint_that_is_no_angle_of_its_own_is_refused_when_named(tmp_path: Path) -> None:
    path = str(urdf(tmp_path, b="prismatic"))
    assert robots.load(path).dof == 1  # by default the chain ends before it
    assert 'joint "b": a prismatic joint' in complaint(path, tip="tip")
    path = str(urdf(tmp_path, mimic='<mimic joint="a"/>'))
    assert 'joint "b": mimics' in complaint(path, tip="tip")


def test_what_is_wrong_with_a_urdf_is_named(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    assert 'no link "hand"' in complaint(str(path), tip="hand")
    assert 'no chain from "tip" to "base"' in complaint(str(path), base="tip", tip="base")
    assert "no single chain" in complaint(str(urdf(tmp_path, a="prismatic")))
    for old, new, words in (
        ('lower="-1"', 'lower="5"', 'joint "a", limit: lower 5, upper 2; radians within'),
        ('lower="-1" upper="2"', "", 'joint "a", limit: lower 0, upper 0'),
        ('upper="2"', 'upper="1e300"', "upper 1e+300"),
        ('xyz="0 0 0.3"', 'xyz="0 0 1e300"', "1e+300 m away; at most 1000 m is plausible. Write"),
    ):
        path.write_text(URDF.format(a="revolute", b="revolute", mimic="").replace(old, new))
        assert words in complaint(str(path))
    path.write_text("<robot><link/>")
    assert "not valid XML" in complaint(str(path))
    path.write_text("<sdf/>")
    assert "a URDF holds <robot>" in complaint(str(path))
    path.write_text('<robot><link name="a"/><link name="b"/></robot>')
    assert "2 links without a parent: a, b" in complaint(str(path))
