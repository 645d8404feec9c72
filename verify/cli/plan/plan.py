"""Plan the motion of the next session."""

from enum import StrEnum
from math import radians
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from verify.cli import options
from verify.errors import InputError

DEFAULT_POSES = 12


ObservableChoice = StrEnum(  # what the motion is to make observable
    "ObservableChoice", "offsets gains backlash eccentricity kinematics clock"
)


def plan(
    robot: Annotated[str, Argument(help="An arm's name, a robot file or a URDF.")],
    rig: Annotated[
        Path | None,
        Argument(help="rig.toml, or a folder that holds one; without it a rig to be built."),
    ] = None,
    camera: Annotated[
        list[str] | None,
        Option(help="Of a rig to be built: pixels, horizontal view: 1280x720,60deg."),
    ] = None,
    baseline: Annotated[
        list[str] | None, Option(help="Between its cameras: 0.4 (metres) or 400mm.")
    ] = None,
    distance: Annotated[
        list[str] | None, Option(help="From the cameras to the arm's work: 1.0 or 1000mm.")
    ] = None,
    led: Annotated[
        list[str] | None, Option(help="LEDs and the circle that they stand on: 4,120mm.")
    ] = None,
    assume: Annotated[
        list[str] | None,
        Option(help="Standard uncertainty of a rig to be built: base_position_mm=0.2."),
    ] = None,
    table: Annotated[
        bool, Option("--table", help="A row for each rig that the values describe.")
    ] = False,
    tolerance: options.JointTolerance = None,
    marker: Annotated[
        Path | None, Option(help="marker.toml; default: the one beside the rig.")
    ] = None,
    out: Annotated[
        Path | None, Option("-o", "--out", help="Folder of the plan; default: ROBOT-plan.")
    ] = None,
    observe: Annotated[
        list[ObservableChoice] | None,
        Option(help="To be shown; repeatable. Default: offsets, gains, backlash, clock."),
    ] = None,
    poses: Annotated[
        int | None, Option(min=4, max=60, help="Number of poses; 12 without --duration-s.")
    ] = None,
    duration_s: Annotated[
        float | None, Option(help="Duration, filled with as many poses as fit.")
    ] = None,
    hold_s: Annotated[
        float, Option(min=0.0, max=3600.0, help="Seconds of rest at each pose.")
    ] = 0.5,
    speed_deg_s: Annotated[
        float,
        Option(min=1e-3, help="Greatest speed of any joint; the arm's own limits also apply."),
    ] = 30.0,
    near: Annotated[
        str | None, Option(help="Posture to stay near, degrees: 0,-60,45,0,-85,15.")
    ] = None,
    within_deg: Annotated[
        float, Option(help="Greatest distance of each joint from --near.")
    ] = 45.0,
    floor_mm: Annotated[
        float, Option(help="Lowest height of any part of the arm; robot's base frame.")
    ] = 0.0,
    view_angle_deg: Annotated[
        float, Option(help="LEDs are visible up to this angle from the flange's z; 180: all.")
    ] = 60.0,
    rate_hz: Annotated[float, Option(max=200.0, help="Stereo pairs per second.")] = 10.0,
    spot_noise_px: Annotated[
        float, Option(help="Standard uncertainty of an LED's image, each coordinate.")
    ] = 0.05,
    reading_noise_deg: Annotated[
        float, Option(help="Standard deviation of an encoder reading.")
    ] = 0.01,
    skew_ms: Annotated[float, Option(help="Right picture after the left picture.")] = 0.0,
    clock_uncertainty_ms: Annotated[
        float | None, Option(help="Of a clock offset that will be stated; else it is estimated.")
    ] = None,
    seed: Annotated[int, Option(min=0, help="Seed of the random postures.")] = 0,
    force: options.ReplaceFiles = False,
) -> None:
    """Plan a motion that shows what you ask, and predict how well each joint will be known.

    With RIG for cameras that are calibrated; without it for a rig that does not exist yet, with
    typical uncertainties. Give several cameras, baselines, distances or LEDs to compare rigs.

    The LEDs stay in view of both cameras, joints within limits and clear of singularities, every
    joint turns both ways. Obstacles are not known: try the motion slowly first.

    Example: verify plan iust_6r --camera 1280x720,60deg --baseline 0.4 --distance 1.5 -o rig_plan
    """
    import robots
    from verify.cli.plan import proposal
    from verify.cli.plan.session import parse_posture, plan_session, planning_setup
    from verify.io.files import restated
    from verify.planning.request import DEFAULT_KINDS, PlanRequest, SessionConditions
    from verify.planning.results import PlanProvenance

    if poses is not None and duration_s is not None:
        raise InputError(
            "--duration-s", "is given with --poses", "one of them says how long the plan is",
            "Leave one out.",
        )  # fmt: skip
    options.require_positive({
        "--speed-deg-s": speed_deg_s, "--within-deg": within_deg, "--rate-hz": rate_hz,
        "--view-angle-deg": view_angle_deg, "--duration-s": duration_s,
        "--spot-noise-px": spot_noise_px, "--reading-noise-deg": reading_noise_deg,
    })  # fmt: skip
    options.require_positive(
        {"--hold-s": hold_s, "--clock-uncertainty-ms": clock_uncertainty_ms}, zero=True
    )
    if not abs(skew_ms) * 1e-3 < 1 / rate_hz:
        raise InputError("--skew-ms", f"{skew_ms:g} ms", "less than the time between two pairs")
    with restated(robots.RobotError):
        arm = robots.load(robot)
    built = {"--camera": camera, "--baseline": baseline, "--distance": distance, "--led": led}
    _check_rig(rig, built | {"--assume": assume}, marker, table=table)
    request = PlanRequest(
        observe=tuple(dict.fromkeys(kind.value for kind in observe or ())) or DEFAULT_KINDS,
        poses=None if duration_s is not None else poses or DEFAULT_POSES,
        duration=duration_s,
        hold=hold_s,
        speed=radians(speed_deg_s),
        view_angle=radians(min(view_angle_deg, 180.0)),
        floor=floor_mm * 1e-3,
        near=None if near is None else parse_posture(near, arm),
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
    allowed = options.ToleranceOptions(tolerance, None, None).tolerance(arm.dof).joints
    if rig is not None:
        setup, inputs, warnings = planning_setup(arm, rig, marker)
        provenance = PlanProvenance(setup, request, conditions, inputs, warnings, None, allowed)
        plan_session(provenance, out, force=force)
        return
    rigs = proposal.proposed_rigs(built, assume or [], table=table)
    if table or len(rigs) > 1:
        options.refuse_options(
            {"--tolerance": tolerance is not None}, f"is given with {len(rigs)} rigs",
            "a table of rigs has uncertainties alone", "Leave it out, or give one rig.",
        )  # fmt: skip
        proposal.compare_rigs(arm, rigs, request, conditions, out, force=force)
        return
    setup, request = proposal.propose_setup(arm, rigs[0], request)
    provenance = PlanProvenance(setup, request, conditions, {}, (), rigs[0], allowed)
    with proposal.describing_remedies():
        plan_session(provenance, out, force=force)


def _check_rig(
    rig: Path | None, built: dict[str, list[str] | None], marker: Path | None, *, table: bool
) -> None:
    """Refuse options that contradict each other; `built` describes a rig to be built."""
    if rig is not None:
        options.refuse_options(
            {name: bool(value) for name, value in built.items()} | {"--table": table},
            f"is given with {rig}", "it describes a rig that is still to be built",
            "Leave RIG out, or the option.",
        )  # fmt: skip
        return
    if not table and not any(built.values()):
        raise InputError(
            "RIG", "is not given", "a rig.toml is needed, or a description of a rig to be built",
            "Example: verify plan iust_6r --camera 1280x720,60deg --baseline 0.4 --distance 1.5",
        )  # fmt: skip
    options.refuse_options(
        {"--marker": marker is not None}, "is given without RIG",
        "a rig to be built has the LEDs of --led", "Give RIG as well.",
    )  # fmt: skip
