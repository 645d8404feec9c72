"""The arms that verify knows: their tables, limits and reach, and a check of their kinematics."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from verify.cli.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    import robots as arms

TOL_KINEMATICS = 1e-9  # m and rad: beyond it closed form, forward kinematics and pinocchio disagree


def robots(
    name: Annotated[
        str | None, Argument(help="An arm's name, or the path of a robot file or URDF.")
    ] = None,
    poses: Annotated[int, Option(min=1, help="Random poses of the self-check.")] = 1000,
    seed: Annotated[int, Option(min=0, help="Seed of the random poses.")] = 0,
    urdf: Annotated[
        Path | None,
        Option("--export-urdf", help="Write a robot file's arm as a URDF, and nothing else."),
    ] = None,
) -> int:
    """List the arms, or show one and check its kinematics.

    Exit status 1 where closed form, forward kinematics and pinocchio disagree by more than 1e-9.

    Example: verify robots iust_6r
    """
    import robots as arms
    from verify.io.files import restated

    if name is None:
        if urdf is not None:
            raise typer.BadParameter("--export-urdf needs the name of an arm")
        for arm_name in arms.names():
            arm = arms.load(arm_name)
            terminal.say(f"{arm_name:20} {arm.description}")
            terminal.record("robot", name=arm_name, description=arm.description)
        return 0
    with restated(arms.RobotError):
        arm = arms.load(name)
        if urdf is not None:
            return _export(arm, urdf)
        terminal.say(_table(arm))
        check = arms.self_check(arm, poses=poses, seed=seed)
    return _report(arm, check)


def _export(arm: "arms.Arm", path: Path) -> int:
    """Write the arm as a URDF; nothing is overwritten."""
    import robots as arms
    from verify.errors import InputError
    from verify.io.files import refused_as_input_error, write_whole
    from verify.io.results import refuse_file

    text = arms.export_urdf(arm)
    refuse_file(path, force=True)
    with refused_as_input_error(path):
        there = path.exists()
    if there:
        raise InputError(path, "exists", "nothing is overwritten unasked", "Choose another name.")
    write_whole(path, text.encode())
    terminal.say(f"{path}: {arm.name} from base_link to tool0")
    terminal.record("result", out=str(path))
    return 0


def _table(arm: "arms.Arm") -> str:
    import io

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    import robots as arms

    dh = isinstance(arm, arms.DhArm)
    heads = ["joint", *(["a mm", "d mm", "alpha deg", "sign", "offset deg"] if dh else [])]
    table = Table(*heads, "lower deg", "upper deg", title=arm.name)
    for j in range(arm.dof):
        cells = [str(j + 1) if arm.linkage is None else arm.axis_formula(j)]
        if isinstance(arm, arms.DhArm):
            figures = (arm.a[j] * 1e3, arm.d[j] * 1e3, np.rad2deg(arm.alpha[j]))
            cells += [f"{v:g}" for v in (*figures, arm.sign[j], np.rad2deg(arm.offset[j]))]
        elif isinstance(arm, arms.UrdfArm):
            cells[0] += f" {arm.joint_names[j]}"
        cells += [f"{np.rad2deg(v):g}" for v in (arm.lower[j], arm.upper[j])]
        table.add_row(*cells)
    text = io.StringIO()
    # names come from the user's file: what looks like markup in them is part of the name
    Console(file=text, width=100, markup=False, emoji=False).print(table)
    reach = arms.reach(arm)
    span = f"reach {reach.minimum * 1e3:.1f} to {reach.maximum * 1e3:.1f} mm, {reach.meaning}"
    if isinstance(arm, arms.UrdfArm):
        span += f"\nclosed form: {_closed_form(arm)}"
    return f"{text.getvalue()}{span}\nsource: {arm.source}"


def _closed_form(arm: "arms.UrdfArm") -> str:
    form = arm.closed_form
    if form is None:
        return "none known; joint angles are found by iteration"
    if form.searched:
        return f"none; all joint angles are found by a search over one joint ({form})"
    given = ", joint 7 given" if arm.dof == 7 else ""
    return f"{form}{given}{'' if form.exact else ', refined for angles that the file rounds'}"


def _report(arm: "arms.Arm", check: "arms.SelfCheck") -> int:
    figures = {
        "inverse against forward kinematics, position, m": check.inverse_position,
        "inverse against forward kinematics, rotation, rad": check.inverse_rotation,
        "forward kinematics against pinocchio, position, m": check.pinocchio_position,
        "forward kinematics against pinocchio, rotation, rad": check.pinocchio_rotation,
        "Jacobian against pinocchio": check.pinocchio_jacobian,
    }
    terminal.say(f"worst disagreement over {check.poses} random poses:")
    for what, figure in figures.items():
        terminal.say(f"  {what}: {figure:.1e}")
    terminal.detail(f"  Jacobian against differences: {check.difference_jacobian:.1e} (not judged)")
    terminal.say(f"  poses whose joints were not among the solutions: {check.lost}")
    good = all(figure <= TOL_KINEMATICS for figure in figures.values()) and check.lost == 0
    terminal.say("self-check: " + ("sound" if good else f"FAILED, above {TOL_KINEMATICS:g}"))
    terminal.record("robot", name=arm.name, self_check=figures, sound=good)
    return 0 if good else 1
