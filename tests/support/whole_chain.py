"""The whole chain from one seed: boards, rig, fixture, session, each measured with the one before.

Everything true is drawn: two cameras on turning bases, the printed square, where the fixture's
board sits on the robot, where the LEDs sit on the flange, every pan angle, the clock. Handed on is
only what the tool found and what a user would state. The arm is healthy: its mean errors are zero.
At spot level corners and LEDs are projected by OpenCV (in verify.simulation) and given noise; with
pictures they are rendered and found again.
"""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from robots.transforms import difference, invert
from tests.bench.calibration import deviation
from tests.bench.cells import Checked, checked
from tests.support.boards.calibrated import squared_distance
from tests.support.boards.drawn_corners import board_pairs
from tests.support.random_scenarios import random_scenario
from tests.support.simulated import InMemory, in_memory, measured_at_spots
from verify.analysis.clock.estimate import ClockEstimate
from verify.analysis.comparison import compare
from verify.analysis.joint_errors import resolve_errors
from verify.analysis.model import build_model
from verify.analysis.session import analyse
from verify.calibration.corners.find import find_board
from verify.calibration.registration.fixture import (
    BASE_NAMES,
    FixtureRegistration,
    register_fixture,
)
from verify.calibration.stereo.calibrate import calibrate
from verify.calibration.stereo.gauge import BASE_TURNING, AdjustmentModel, apply_gauge
from verify.calibration.stereo.parameters import BundleState
from verify.calibration.stereo.records import covariance_in_si
from verify.core.fiducials import Board, BoardPair
from verify.core.readings import Readings
from verify.core.records import Array
from verify.core.rig import Rig
from verify.errors import InputError
from verify.io.session.keys import Clock as ToldClock
from verify.measurement.pose import perturb
from verify.measurement.systematics import sensitivities, stated_systematics
from verify.measurement.track import collect_track
from verify.simulation.boards.simulate import simulate_boards
from verify.simulation.scenario import (
    BoardRig,
    BoardScenario,
    BoardScenarioBases,
    BoardScenarioFixture,
    ScenarioBoards,
    ScenarioCamera,
    ScenarioClock,
    ScenarioRecording,
    ScenarioRig,
    ScenarioUncertainty,
)
from verify.simulation.session.simulate import SimulatedSession

ARMS = ("iust_6r", "rv_3sd_melfa")
WRIST, STRAIGHT = 4, 0.3  # sine of joint 5 below which axes 4 and 6 all but line up
ATTEMPTS = 50  # a posture or a board out of view is drawn again

BOARD_PAIRS, FIXTURE_PAIRS, PAIRS = 20, 5, 12
BOARD = Board(columns=9, rows=7, square=0.04, square_standard_uncertainty=8e-6)
FIXTURE_BOARD = Board(columns=8, rows=5, square=0.03)
CORNER_PX = 0.04
PAN_DEG = 0.01  # of each reading
FINE_DEG = 1e-6  # no two readings are alike: registration takes like ones to err alike
FIXTURE = np.array([1e-4] * 3 + [np.deg2rad(0.02)] * 3)  # m, rad: of the board on the base
STATED = ScenarioUncertainty(led_body_mm=0.03, led_body_deg=0.02, led_mm=0.02, pan_deg=PAN_DEG)
CLOCK = ScenarioClock(encoder_offset_standard_uncertainty_s=0.001)


def replicate(
    seed: int, pixels: bool = False, arms: Sequence[str] = ARMS, apart: bool = False
) -> dict[str, Checked]:
    """Calibrate, register and measure once.

    Args:
        seed: the only source of chance.
        pixels: render all pictures and find corners and spots in them.
        arms: healthy arms, each at a place of its own in the one rig.
        apart: also measure as if base and cameras had been found independently of each other.

    Returns:
        "rig", and an arm "… base", "… base given rig", "… means" and "… means apart".
    """
    rng = np.random.default_rng(seed)
    table = _rig_table(rng)
    true, found = _calibrated(rng, table, pixels)
    outcome = {"rig": _of_rig(found, true)}
    for arm in arms:
        session = _session(rng, arm, table, pixels)
        registration = _registered(rng, session, table, found, pixels)
        outcome |= _of_base(arm, registration, true, session.simulated.world.bench.rig_T_base)
        rigs = {"means": registration.rig, "means apart": decorrelated(registration.rig)}
        noise = int(rng.integers(2**31))
        for name in ("means", "means apart") if apart else ("means",):
            output = replace(session, rig=_standing(rigs[name], session))
            mean, covariance = _through_pixels(output) if pixels else _at_spots(output, noise)
            joints = [f"q{j + 1}" for j in range(len(mean))]
            outcome[f"{arm} {name}"] = checked(joints, mean, covariance)
    return outcome


def decorrelated(rig: Rig) -> Rig:
    """Forget that the base was found through the cameras."""
    base = np.array([n in BASE_NAMES for n in rig.covariance.parameters])
    alike = base[:, None] == base
    alone = replace(rig.covariance, correlation=np.where(alike, rig.covariance.correlation, 0.0))
    return replace(rig, covariance=alone)


def _rig_table(rng: np.random.Generator) -> BoardRig:
    baseline = rng.uniform(140, 240)
    return BoardRig(baseline_mm=baseline, left=_camera(rng), right=_camera(rng))


def _camera(rng: np.random.Generator) -> ScenarioCamera:
    """Draw a webcam whose axis is not upright and that does not sit on it."""
    focal = rng.uniform(950, 1100)
    centre = np.array([639.5, 359.5]) + rng.uniform(-12, 12, 2)
    lens = rng.uniform([-0.12, -0.05, -8e-4, -8e-4, 0], [0.05, 0.08, 8e-4, 8e-4, 0])
    return ScenarioCamera(
        focal_px=(focal, focal * rng.uniform(0.997, 1.003)),
        principal_point_px=tuple(centre.tolist()),
        distortion=tuple(lens.tolist()),
        pan_axis=(rng.uniform(-0.03, 0.03), 1.0, rng.uniform(-0.03, 0.03)),
        pan_zero_deg=rng.uniform(-1, 1),
        mount_rotation_deg=tuple(rng.uniform(-1.5, 1.5, 3).tolist()),
        mount_offset_mm=tuple(rng.uniform(-20, 20, 3).tolist()),
    )


def _pairs(scenario: BoardScenario, pixels: bool) -> list[BoardPair]:
    """What a corner finder hands over: true corners with noise, or those found in pictures."""
    if not pixels:
        return board_pairs(scenario)[0]
    boards = simulate_boards(scenario)
    return [
        BoardPair(i, *pan, *(find_board(boards.image(side, i), boards.board) for side in (0, 1)))
        for i, pan in enumerate(boards.pan.tolist())
    ]


def _calibrated(rng: np.random.Generator, table: BoardRig, pixels: bool) -> tuple[Rig, Rig]:
    """The true rig and the one found from boards whose squares are a little off."""
    u = BOARD.square_standard_uncertainty or 0.0
    scenario = BoardScenario(
        format=1,
        seed=int(rng.integers(2**31)),
        boards=ScenarioBoards(
            pairs=BOARD_PAIRS,
            square_mm=1e3 * (BOARD.square + u * rng.normal()),
            corner_noise_px=CORNER_PX,
        ),
        bases=BoardScenarioBases(
            range_deg=20.0, step_deg=FINE_DEG, standard_uncertainty_deg=PAN_DEG
        ),
        rig=table,
    )
    found = calibrate(_pairs(scenario, pixels), BOARD, table.image_size)
    return simulate_boards(scenario).rig, found.rig


def _session(rng: np.random.Generator, arm: str, table: BoardRig, pixels: bool) -> InMemory:
    """Play a healthy arm before the true rig; its clock is told with an error."""
    for _ in range(ATTEMPTS):
        scenario = random_scenario(rng, arm, leds=int(rng.integers(3, 6)), pairs=PAIRS)
        rig = ScenarioRig(
            baseline_mm=table.baseline_mm,
            distance_mm=scenario.rig.distance_mm,
            left=table.left,
            right=table.right,
        )
        scenario = msgspec.structs.replace(scenario, rig=rig, uncertainty=STATED, clock=CLOCK)
        if not pixels:  # both cameras at one instant: nothing to align
            together = ScenarioRecording(pairs=PAIRS, rate_hz=scenario.recording.rate_hz)
            scenario = msgspec.structs.replace(scenario, recording=together)
        try:
            session = in_memory(scenario)
        except InputError:  # nowhere to look from with these cameras
            continue
        if np.all(np.abs(np.sin(session.truth[:, WRIST])) > STRAIGHT):
            u = CLOCK.encoder_offset_standard_uncertainty_s
            offset = session.simulated.clock_offset
            assert offset is not None
            return replace(session, clock=ToldClock(offset, u))
    raise RuntimeError(f"{ATTEMPTS} postures of {arm} drawn, none of them in view")


def _registered(
    rng: np.random.Generator, session: InMemory, table: BoardRig, found: Rig, pixels: bool
) -> FixtureRegistration:
    """See a board on the robot's base, whose place there is not quite the stated one."""
    played = session.simulated
    base = played.world.bench.rig_T_base
    for _ in range(ATTEMPTS):
        output: Array = invert(base) @ _before_the_cameras(rng, played)
        true = perturb(output, FIXTURE * rng.normal(size=6))
        scenario = BoardScenario(
            format=1,
            seed=int(rng.integers(2**31)),
            boards=ScenarioBoards(
                pairs=FIXTURE_PAIRS,
                inner_corners=(FIXTURE_BOARD.columns, FIXTURE_BOARD.rows),
                square_mm=1e3 * FIXTURE_BOARD.square,
                corner_noise_px=CORNER_PX,
            ),
            bases=BoardScenarioBases(
                middle_deg=tuple(np.rad2deg(played.pan[0]).tolist()),
                range_deg=6.0,
                step_deg=FINE_DEG,
                standard_uncertainty_deg=PAN_DEG,
            ),
            rig=table,
            fixture=_fixture(true, base),
        )
        try:
            pairs = _pairs(scenario, pixels)
        except InputError:  # not whole in both pictures
            continue
        return register_fixture(found, pairs, FIXTURE_BOARD, output, np.diag(FIXTURE**2))
    raise RuntimeError(f"{ATTEMPTS} places of the fixture's board drawn, none of them in view")


def _before_the_cameras(rng: np.random.Generator, played: SimulatedSession) -> Array:
    """A board near where the LEDs move, facing the rig more or less; rig_T_board."""
    middle = played.world.led_points(played.t[:, 0]).mean(axis=(0, 1))
    turn = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * [25, 25, 20], degrees=True)
    pose = np.eye(4)
    pose[:3, :3] = turn.as_matrix()
    pose[:3, 3] = middle * rng.uniform(0.9, 1.3) - turn.apply(FIXTURE_BOARD.points.mean(axis=0))
    return pose


def _fixture(base_T_board: Array, rig_T_base: Array) -> BoardScenarioFixture:
    rotations = np.array([base_T_board[:3, :3], rig_T_base[:3, :3]])
    turns = Rotation.from_matrix(rotations).as_rotvec(degrees=True)
    return BoardScenarioFixture(
        board_rotation_deg=tuple(turns[0].tolist()),
        board_position_mm=tuple((1e3 * base_T_board[:3, 3]).tolist()),
        base_rotation_deg=tuple(turns[1].tolist()),
        base_position_mm=tuple((1e3 * rig_T_base[:3, 3]).tolist()),
    )


def _in_the_gauge(true: Rig, rig_T_base: Array) -> tuple[Rig, Array]:
    """The true rig and base in the frame that a calibration chooses."""
    state = BundleState(true.left, true.right, rig_T_base[None], np.zeros((1, 5)))
    same = apply_gauge(state, AdjustmentModel((BASE_TURNING, BASE_TURNING)), np.zeros(2))
    return replace(true, left=same.left, right=same.right), same.boards[0]


def _rig_error(found: Rig, true: Rig) -> tuple[tuple[str, ...], Array, Array]:
    """Names of the cameras' parameters, their errors and covariance, SI units and pixels."""
    names = tuple(n for n in found.covariance.parameters if n not in BASE_NAMES)
    full = covariance_in_si(found.covariance)[: len(names), : len(names)]
    return names, np.array([deviation(n, found, true) for n in names]), full


def _of_rig(found: Rig, true: Rig) -> Checked:
    return checked(*_rig_error(found, _in_the_gauge(true, np.eye(4))[0]))


def _of_base(
    arm: str, registration: FixtureRegistration, true: Rig, rig_T_base: Array
) -> dict[str, Checked]:
    """The base by itself, and beside the cameras it was found through."""
    found = registration.rig
    assert found.covariance is not None
    same, base = _in_the_gauge(true, rig_T_base)
    error = difference(found.rig_T_base, base)
    alone = checked(BASE_NAMES, error, registration.base_covariance)
    _, cameras, full = _rig_error(found, same)
    d2, degrees = squared_distance(cameras, full)
    both = squared_distance(np.concatenate([cameras, error]), covariance_in_si(found.covariance))
    # what a joint d² has over a part's is that of the rest, given the part
    beyond = Checked((), np.zeros(0), both[0] - d2, both[1] - degrees)
    return {f"{arm} base": alone, f"{arm} base given rig": beyond}


def _standing(rig: Rig, session: InMemory) -> Rig:
    """The rig with its bases where the session has them."""
    left, right = (
        replace(camera, pan=float(pan))
        for camera, pan in zip((rig.left, rig.right), session.simulated.pan[0], strict=True)
    )
    return replace(rig, left=left, right=right)


def _through_pixels(session: InMemory) -> tuple[Array, Array]:
    """Mean joint errors (j,) and their covariance (j, j) as the summary states them, rad."""
    summary = analyse(session).summary
    joints = summary["joints"]
    mean = np.deg2rad([float(j["mean_error_deg"]) for j in joints])
    u = np.deg2rad([float(j["standard_uncertainty_deg"]) for j in joints])
    return mean, np.array(summary["joint_error_correlation"]) * np.outer(u, u)


def _at_spots(session: InMemory, noise_seed: int) -> tuple[Array, Array]:
    """The same from true spots with white noise instead of pictures."""
    rng, rig = np.random.default_rng(noise_seed), session.rig
    marker, arm = session.marker, session.arm
    parameters = stated_systematics(rig, marker, turning=False)
    found = list(measured_at_spots(session, parameters, rng))
    track = collect_track(found, rig, [sensitivities(parameters, m, rig, marker) for m in found])
    output = session.clock.encoder_offset, session.clock.standard_uncertainty
    readings = Readings(session.encoders.t, session.encoders.q)
    comparison = compare(track, arm, readings, output[0])
    clock = ClockEstimate(*output, "given", np.zeros((0, 2)))
    model = build_model(comparison, track, rig, marker, clock, parameters)
    resolved = resolve_errors(model)
    return resolved.mean, resolved.mean_covariance
