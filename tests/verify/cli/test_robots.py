"""`verify robots`: what it lists and checks, and the URDF that it writes."""

from pathlib import Path

import pytest

import robots
from tests.support.command import verify


def test_a_urdf_is_written_once_and_says_where_it_cannot_be(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    assert (
        "arm.urdf: abb_irb_120" in verify("robots", "abb_irb_120", "--export-urdf", str(path)).out
    )
    written = robots.load(str(path))
    assert (written.base, written.tip, written.dof) == ("base_link", "tool0", 6)
    for name, reason in (("arm.urdf", "exists; nothing is overwritten"), ("u" * 300, "too long")):
        refused = verify("robots", "abb_irb_120", "--export-urdf", str(tmp_path / name))
        assert reason in refused.refusal


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["fanuc_lr_mate_200id"], "joint 3: its axis turns by q3 + q2"),
        (["ur5"], "ur5: comes from a URDF. Copy that file"),
        ([], "--export-urdf needs the name of an arm"),
    ],
)
def test_an_export_that_cannot_be_is_refused_in_a_line(
    words: list[str], reason: str, tmp_path: Path
) -> None:
    refused = verify("robots", *words, "--export-urdf", str(tmp_path / "arm.urdf"))
    assert reason in refused.refusal
    assert not (tmp_path / "arm.urdf").exists()


def test_a_urdfs_closed_form_is_named() -> None:
    assert "closed form: parallel_axes" in verify("robots", "ur5", "--poses", "20").out
    assert "from flange to base, joint 7 given" in verify("robots", "panda", "--poses", "20").out


def test_an_emulator_of_an_unknown_robot_is_refused_in_one_line() -> None:
    refusal = verify("emulate", "rosbridge", "--port", "tcp:0", "--robot", "ur11").refusal
    assert '--robot: robot "ur11" is not known' in refusal


ODD = """<robot name="odd">
  <link name="base"/><link name="upper"/><link name="lower"/>
  <joint name="swing[/left]" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="lift[red] :a:" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_names_of_joints_are_shown_as_the_urdf_has_them(tmp_path: Path) -> None:
    path = tmp_path / "odd.urdf"
    path.write_text(ODD)
    shown = verify("robots", str(path), "--poses", "5").out
    assert "1 swing[/left]" in shown
    assert "2 lift[red] :a:" in shown
