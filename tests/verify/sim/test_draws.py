import numpy as np
import pytest

from verify.errors import InputError
from verify.sim.draws import POSTURES_DEG, random_scenario
from verify.sim.sessions import simulate


@pytest.mark.parametrize("arm_name", sorted(POSTURES_DEG))
def test_random_sessions_keep_every_led_in_view_and_clear_of_singularities(arm_name: str) -> None:
    rng = np.random.default_rng(4)
    for _ in range(4):
        session = simulate(random_scenario(rng, arm_name))
        assert 3 <= len(session.marker) <= 5
        assert np.all(np.abs(np.sin(session.truth[:, 4])) > 0.3)
        points = session.world.led_points(session.t[:, 0])
        for side, camera in enumerate(session.world.bench.cameras):
            spots = session.spots(side)
            assert np.all((spots > 20) & (spots < np.array(camera.image_size) - 21))
            eyes = np.array([camera.rig_T_camera(pan)[:3, 3] for pan in session.true_pan[:, side]])
            toward = eyes[:, None] - points
            toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
            cosine = np.sum(toward * session.world.led_normals(session.t[:, 0]), axis=-1)
            assert cosine.min() > np.cos(
                np.radians(70)
            )  # 60° from the rig's middle; 10° for half the baseline


def test_random_sessions_differ_and_repeat_with_their_seed() -> None:
    one, two = (random_scenario(np.random.default_rng(s), "iust_6r") for s in (1, 2))
    assert one != two
    assert one == random_scenario(np.random.default_rng(1), "iust_6r")


def test_a_wanted_number_of_leds_is_kept() -> None:
    assert len(random_scenario(np.random.default_rng(1), "iust_6r", leds=5).marker.led) == 5


def test_an_arm_without_a_known_posture_is_refused() -> None:
    with pytest.raises(InputError, match="no posture"):
        random_scenario(np.random.default_rng(1), "ur5")
