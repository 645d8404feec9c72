"""Scenarios drawn at random, for tests that need hundreds of different sessions."""

import numpy as np

from verify.errors import InputError
from verify.simulation.scenario import (
    MultiJoint,
    Scenario,
    ScenarioCamera,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioImage,
    ScenarioLed,
    ScenarioMarker,
    ScenarioRecording,
    ScenarioRig,
)
from verify.simulation.session.simulate import simulate_session

# Postures amid the joint ranges, wrist bent, flange turned towards free space: home is drawn
# about them by as many degrees.
POSTURES_DEG: dict[str, tuple[list[float], list[float]]] = {
    "iust_6r": ([20.0, -60.0, 45.0, 0.0, -85.0, 15.0], [60.0, 15.0, 20.0, 25.0, 25.0, 90.0]),
    "rv_3sd_melfa": ([10.0, 15.0, 95.0, 10.0, 50.0, 20.0], [60.0, 20.0, 15.0, 40.0, 15.0, 90.0]),
    "rv_3sd": ([10.0, -60.0, 60.0, 10.0, 50.0, 20.0], [60.0, 20.0, 20.0, 40.0, 15.0, 90.0]),
}
APART_MM = 55.0  # between any two LEDs: their images never merge
OFF_LINE_MM = 25.0  # the LEDs' second extent: far from standing on one line, which hides a turn
WRIST = 4  # joint 5 of all these arms: where its sine vanishes, axes 4 and 6 line up
ATTEMPTS = 200  # a posture that no camera sees is drawn again, which is seldom


def random_scenario(
    rng: np.random.Generator, arm_name: str, leds: int | None = None, pairs: int = 40
) -> Scenario:
    """Draw a healthy session: rig, marker, motion and noise all vary, every LED is in view.

    Args:
        rng: the only source of chance; the scenario's seed is drawn from it too.
        arm_name: a key of POSTURES_DEG.
        leds: how many; drawn from 3 to 5 if None.
        pairs: how many.

    Returns:
        A scenario that `simulate_session` accepts; faults and uncertainties are added
        with msgspec.structs.replace.

    Raises:
        InputError: no posture is known for the arm.
    """
    if arm_name not in POSTURES_DEG:
        known = ", ".join(POSTURES_DEG)
        raise InputError(arm_name, "no posture is known for this arm", f"one of {known}")
    for _ in range(ATTEMPTS):
        scenario = _draw(rng, arm_name, leds or int(rng.integers(3, 6)), pairs)
        try:
            session = simulate_session(scenario)
        except InputError:  # outside the limits, or no place to look from
            continue
        if np.all(np.abs(np.sin(session.truth[:, WRIST])) > 0.3):  # 17°: clear of that singularity
            return scenario
    raise RuntimeError(f"{ATTEMPTS} postures of {arm_name} drawn, none of them in view")


def _draw(rng: np.random.Generator, arm_name: str, leds: int, pairs: int) -> Scenario:
    middle, spread = (np.array(v) for v in POSTURES_DEG[arm_name])
    home = middle + spread * rng.uniform(-1, 1, 6)
    amplitude = rng.uniform(8, 22, 6) * [1.0, 0.7, 1.0, 1.0, 1.0, 1.6]
    return Scenario(
        format=1,
        robot=arm_name,
        seed=int(rng.integers(2**31)),
        motion=MultiJoint(
            home_deg=np.round(home, 2).tolist(),
            amplitude_deg=np.round(amplitude, 2).tolist(),
            slowest_hz=0.12,
            fastest_hz=float(np.round(rng.uniform(0.3, 0.6), 3)),
        ),
        recording=ScenarioRecording(
            pairs=pairs,
            rate_hz=float(rng.choice([10.0, 15.0, 30.0])),
            skew_s=float(np.round(rng.uniform(-0.005, 0.005), 6)),
            skew_jitter_s=0.0005,
        ),
        rig=ScenarioRig(
            baseline_mm=float(np.round(rng.uniform(140, 240), 1)),
            distance_mm=float(np.round(rng.uniform(520, 720), 1)),
            bases="follow" if rng.random() < 0.25 else "fixed",
            left=_camera(rng),
            right=_camera(rng),
        ),
        marker=_marker(rng, leds),
        image=ScenarioImage(
            blur_px=float(np.round(rng.uniform(0.5, 1.0), 3)),
            read_noise_dn=float(np.round(rng.uniform(0.8, 2.0), 2)),
            electrons_per_dn=float(np.round(rng.uniform(15, 60), 1)),
            black_level_dn=5.0 if rng.random() < 0.2 else -3.5,  # a pedestal, or a clamp
        ),
        encoders=ScenarioEncoders(clock_offset_s=float(np.round(rng.uniform(-0.2, 0.2), 4))),
        clock=ScenarioClock(),
    )


def _camera(rng: np.random.Generator) -> ScenarioCamera:
    focal = rng.uniform(950, 1100)
    both = np.round([focal, focal * rng.uniform(0.997, 1.003)], 1)
    centre = np.round(np.array([639.5, 359.5]) + rng.uniform(-12, 12, 2), 1)
    lens = rng.uniform([-0.12, -0.05, -8e-4, -8e-4], [0.05, 0.08, 8e-4, 8e-4])
    return ScenarioCamera(
        focal_px=tuple(both.tolist()),
        principal_point_px=tuple(centre.tolist()),
        distortion=(*np.round(lens[:2], 3).tolist(), *np.round(lens[2:], 5).tolist(), 0.0),
    )


def _marker(rng: np.random.Generator, count: int) -> ScenarioMarker:
    """Draw LEDs on a plate of 160 mm before the flange until they stand well apart."""
    while True:
        places = np.round(rng.uniform([-80, -80, 8], [80, 80, 45], (count, 3)), 1)
        apart = np.linalg.norm(places[:, None] - places, axis=-1) + 1e9 * np.eye(count)
        extents = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if apart.min() > APART_MM and (count == 2 or extents[1] > OFF_LINE_MM * np.sqrt(2)):
            break
    peaks = np.round(rng.uniform(150, 230, count), 1)
    return ScenarioMarker(
        led=[
            ScenarioLed(name=name, position_mm=tuple(place), peak_dn=peak)
            for name, place, peak in zip("ABCDEF", places.tolist(), peaks.tolist(), strict=False)
        ],
        led_diameter_mm=float(rng.choice([3.0, 5.0, 5.0, 8.0])),
    )
