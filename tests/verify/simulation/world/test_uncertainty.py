import msgspec
import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.support.simulated import played
from verify.planning.proposal import stated_covariance
from verify.simulation.scenario import ScenarioUncertainty
from verify.simulation.world.motion import RandomStream, generator
from verify.simulation.world.uncertainty import draw_departure

STATED = ScenarioUncertainty(
    focal_px=0.3, principal_point_px=0.2, camera_rotation_deg=0.01, base_position_mm=0.3,
    base_rotation_deg=0.05, led_body_mm=0.1, led_body_deg=0.08, led_mm=0.05, pan_deg=0.02,
)  # fmt: skip
SEEDS = 2000
FOUR_ERRORS = 4 / np.sqrt(2 * SEEDS)  # of a standard deviation from so many draws


def test_draws_have_the_spread_and_correlation_that_the_rig_states() -> None:
    drawn = [draw_departure(STATED, 4, generator(s, RandomStream.SYSTEMATIC)) for s in range(SEEDS)]
    stated = stated_covariance(msgspec.structs.asdict(STATED))
    bases = ([1e3 * d.base[:3], np.degrees(d.base[3:])] for d in drawn)
    columns = np.array(
        [np.hstack([*d.camera, np.degrees(d.turn), *b]) for d, b in zip(drawn, bases, strict=True)]
    )
    assert len(stated.parameters) == columns.shape[1]
    assert_allclose(columns.std(axis=0) / stated.standard_uncertainty, 1, atol=FOUR_ERRORS)
    correlation = np.corrcoef(columns.T)
    assert_allclose(correlation, stated.correlation, atol=4.5 / np.sqrt(SEEDS))
    assert_allclose(np.std([d.leds for d in drawn], axis=0) * 1e3 / 0.05, 1, atol=FOUR_ERRORS * 1.2)
    body = np.std([d.body for d in drawn], axis=0) / ([1e-4] * 3 + [np.radians(0.08)] * 3)
    assert_allclose(body, 1, atol=FOUR_ERRORS)
    assert_allclose(np.std([d.pan for d in drawn], axis=0) / np.radians(0.02), 1, atol=FOUR_ERRORS)


def test_the_truth_lies_off_the_belief_in_the_formats_own_sense() -> None:
    session = played(uncertainty=STATED)
    departure = draw_departure(STATED, 3, generator(session.scenario.seed, RandomStream.SYSTEMATIC))
    true, rig = session.world.bench, session.rig
    # rotations act on the left: R_true = exp(phi) R_stated, in the frame that holds them
    turn = Rotation.from_rotvec(departure.base[3:]).as_matrix()
    assert_allclose(true.rig_T_base[:3, :3], turn @ rig.rig_T_base[:3, :3], atol=1e-12)
    assert_allclose(true.rig_T_base[:3, 3], rig.rig_T_base[:3, 3] + departure.base[:3], atol=1e-15)
    mount = Rotation.from_rotvec(departure.turn).as_matrix() @ rig.right.mount[:3, :3]
    assert_allclose(true.cameras[1].turntable_T_camera[:3, :3], mount, atol=1e-12)
    body = Rotation.from_rotvec(departure.body[3:]).as_matrix()
    leds = session.marker.leds @ body.T + departure.body[:3] + departure.leds
    assert_allclose(true.leds, leds, atol=1e-12)
    fx, fy, cx, cy = departure.camera[0]
    difference = true.cameras[0].matrix - rig.left.matrix
    assert_allclose(difference, [[fx, 0, cx], [0, fy, cy], [0, 0, 0]], atol=1e-9)
    assert_allclose(session.true_pan - session.pan, np.tile(departure.pan, (12, 1)), atol=1e-15)


def test_without_a_draw_the_world_is_that_of_the_files() -> None:
    session = played(uncertainty=ScenarioUncertainty(focal_px=1.0, led_mm=1.0, draw=False))
    assert session.rig.covariance is not None
    assert_allclose(session.world.bench.leds, session.marker.leds, atol=0)
    assert_allclose(session.world.bench.cameras[0].matrix, session.rig.left.matrix, atol=0)


def test_nothing_stated_writes_no_covariance() -> None:
    session = played()
    assert session.rig.covariance is None
    assert session.marker.body_standard_uncertainty is None
    assert session.marker.led_standard_uncertainty is None
