"""Plan the motion of the next session."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from verify.cli.options import ReplaceFiles


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """The options of a plan, in users' units."""

    observe: tuple[str, ...]
    poses: int | None
    duration_s: float | None
    hold_s: float
    speed_deg_s: float
    near: str | None
    within_deg: float
    floor_mm: float
    view_angle_deg: float
    rate_hz: float
    spot_noise_px: float
    reading_noise_deg: float
    skew_ms: float
    clock_uncertainty_ms: float | None
    seed: int


class ObservableChoice(StrEnum):
    """What the motion is to make observable."""

    offsets = "offsets"
    gains = "gains"
    backlash = "backlash"
    eccentricity = "eccentricity"
    kinematics = "kinematics"
    clock = "clock"


def plan(
    robot: Annotated[str, typer.Argument(help="An arm's name, a robot file or a URDF.")],
    rig: Annotated[Path, typer.Argument(help="rig.toml, or a folder that holds one.")],
    marker: Annotated[
        Path | None, typer.Option(help="marker.toml; without it the one beside the rig.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Where the plan goes; ROBOT-plan.")
    ] = None,
    observe: Annotated[
        list[ObservableChoice] | None,
        typer.Option(help="What is to be shown; repeatable. Offsets, gains, backlash, clock."),
    ] = None,
    poses: Annotated[
        int | None, typer.Option(min=4, max=60, help="How many poses; 12 without --duration-s.")
    ] = None,
    duration_s: Annotated[
        float | None, typer.Option(help="As many poses as fit into so many seconds.")
    ] = None,
    hold_s: Annotated[float, typer.Option(min=0.0, help="Seconds of rest at each pose.")] = 0.5,
    speed_deg_s: Annotated[
        float, typer.Option(help="The most of any joint; the arm's own limits hold as well.")
    ] = 30.0,
    near: Annotated[
        str | None, typer.Option(help="A posture to stay about, degrees: 0,-60,45,0,-85,15.")
    ] = None,
    within_deg: Annotated[
        float, typer.Option(help="How far each joint may go from --near.")
    ] = 45.0,
    floor_mm: Annotated[
        float, typer.Option(help="Nothing of the arm goes below; robot's base frame.")
    ] = 0.0,
    view_angle_deg: Annotated[
        float, typer.Option(help="LEDs are seen so far from the flange's z; 180: all round.")
    ] = 60.0,
    rate_hz: Annotated[float, typer.Option(help="Stereo pairs a second.")] = 10.0,
    spot_noise_px: Annotated[
        float, typer.Option(help="Standard uncertainty of an LED's image, each coordinate.")
    ] = 0.05,
    reading_noise_deg: Annotated[
        float, typer.Option(help="Standard deviation of an encoder reading.")
    ] = 0.01,
    skew_ms: Annotated[float, typer.Option(help="Right picture after the left.")] = 0.0,
    clock_uncertainty_ms: Annotated[
        float | None,
        typer.Option(help="Of an encoder clock that will be given; else found from the motion."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the postures that are drawn.")] = 0,
    force: ReplaceFiles = False,
) -> None:
    """Plan a motion that shows what you ask, and predict how well.

    The LEDs stay in view of both cameras, joints within limits and clear of singularities, every
    joint turns both ways. Obstacles are not known: try the motion slowly first.

    Example: verify plan iust_6r rig.toml --observe offsets --observe backlash -o next_session
    """
    from verify.cli.plan.session import plan_session

    options = PlanOptions(
        observe=tuple(kind.value for kind in observe or ()),
        poses=poses, duration_s=duration_s, hold_s=hold_s, speed_deg_s=speed_deg_s, near=near,
        within_deg=within_deg, floor_mm=floor_mm, view_angle_deg=view_angle_deg, rate_hz=rate_hz,
        spot_noise_px=spot_noise_px, reading_noise_deg=reading_noise_deg, skew_ms=skew_ms,
        clock_uncertainty_ms=clock_uncertainty_ms, seed=seed,
    )  # fmt: skip
    plan_session(robot, rig, marker, out, options, force=force)
