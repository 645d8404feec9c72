"""Plan the motion of the next session."""

from enum import StrEnum
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from verify.cli.options import ReplaceFiles, require_positive
from verify.errors import InputError

DEFAULT_POSES = 12


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
    from verify.cli.plan.session import parse_posture, plan_session, planning_setup
    from verify.planning.request import DEFAULT_KINDS, PlanRequest, SessionConditions
    from verify.planning.results import PlanProvenance

    if poses is not None and duration_s is not None:
        raise InputError(
            "--duration-s", "is given with --poses", "one of them says how long the plan is",
            "Leave one out.",
        )  # fmt: skip
    require_positive({
        "--speed-deg-s": speed_deg_s, "--within-deg": within_deg, "--rate-hz": rate_hz,
        "--view-angle-deg": view_angle_deg, "--duration-s": duration_s,
        "--spot-noise-px": spot_noise_px, "--reading-noise-deg": reading_noise_deg,
    })  # fmt: skip
    require_positive(
        {"--hold-s": hold_s, "--clock-uncertainty-ms": clock_uncertainty_ms}, zero=True
    )
    if not abs(skew_ms) * 1e-3 < 1 / rate_hz:
        expected = "less than the time between two pairs"
        raise InputError("--skew-ms", f"{skew_ms:g} ms", expected)
    setup, inputs, warnings = planning_setup(robot, rig, marker)
    request = PlanRequest(
        observe=tuple(dict.fromkeys(kind.value for kind in observe or ())) or DEFAULT_KINDS,
        poses=None if duration_s is not None else poses or DEFAULT_POSES,
        duration=duration_s,
        hold=hold_s,
        speed=radians(speed_deg_s),
        view_angle=radians(min(view_angle_deg, 180.0)),
        floor=floor_mm * 1e-3,
        near=None if near is None else parse_posture(near, setup.arm),
        within=radians(within_deg),
        seed=seed,
    )
    conditions = SessionConditions(
        rate=rate_hz,
        skew=skew_ms * 1e-3,
        spot_noise=spot_noise_px,
        reading_noise=radians(reading_noise_deg),
        clock_uncertainty=None if clock_uncertainty_ms is None else clock_uncertainty_ms * 1e-3,
    )
    provenance = PlanProvenance(setup, request, conditions, inputs, warnings)
    plan_session(provenance, out, force=force)
