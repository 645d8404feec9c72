"""One camera of the rig that creeps during the session, told from bases that do and from joints.

The LEDs of every pair are projected by OpenCV into a camera that truly stands turned by then.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.bench.diagnosis.sessions import Injected, camera_creeps, judged, watched
from tests.support.simulated import HOME_DEG, in_memory, marker_of, measured_at_spots, scene
from verify.analysis.diagnosis.diagnose import Diagnosis
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement
from verify.io.session.keys import Tolerance
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import (
    MultiJoint,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioRecording,
    ScenarioUncertainty,
)

LEFT, RIGHT = 0, 1
SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 5, 8))]
EVENLY, STOPS, AT_ONCE = 1.0, 0.4, 0.0  # share of the session after which a camera stands


def creep(t: Array, angle: float, until: float) -> Array:
    """The camera's turn at each pair, rad; `until` 0: from the middle on."""
    if not until:
        return angle * (t > t.mean())
    return angle * np.minimum((t - t[0]) / np.ptp(t) / until, 1.0)


def crept(seed: int, side: int, pixels: float, until: float) -> tuple[Diagnosis, Array, float]:
    """What is found, joints' mean errors over u, and the right camera's turn against the left."""
    case = watched(seed)
    focal = case.session.simulated.world.bench.cameras[side].matrix[0, 0]
    angles = creep(case.session.frames.t_left, pixels / focal, until)
    spots = camera_creeps(case.session, side, "pan", angles)
    noise = np.random.default_rng(case.noise)
    found = measured_at_spots(case.session, case.systematics, noise, spots=spots)
    _, seen, resolved = judged(replace(case, measurements=tuple(found)), None)
    off = resolved.mean / np.sqrt(np.diag(resolved.mean_covariance))
    return seen, off, float(angles[-1]) * (1 if side == RIGHT else -1)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("side", [LEFT, RIGHT])
@pytest.mark.parametrize(
    ("pixels", "until"), [(1.0, EVENLY), (2.0, EVENLY), (0.5, STOPS), (1.0, STOPS)]
)
def test_a_camera_that_creeps_is_named_and_no_joint(
    seed: int, side: int, pixels: float, until: float
) -> None:
    seen, off, turn = crept(seed, side, pixels, until)
    assert [(c.kind, c.joint) for c in seen.causes] == [("camera_drift", None)]
    (cause,) = seen.causes
    assert abs(cause.value - turn) < 3 * cause.standard_uncertainty < abs(turn)
    assert np.abs(off[~np.isnan(off)]).max() < 4


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_of_half_a_pixel_no_joint_is_said_to_be_the_cause(seed: int, side: int) -> None:
    (cause,) = crept(seed, side, 0.5, EVENLY)[0].causes
    assert "camera_drift" in {cause.kind} | {k.kind for k in cause.candidates}


def test_a_base_that_creeps_is_not_said_to_be_a_camera_where_that_and_a_drift_fit_as_well() -> None:
    fault = Injected("base_drift", None, -8.4e-4, "y")
    (cause,) = judged(watched(111249108), fault)[1].causes
    assert "base_drift" in {cause.kind} | {k.kind for k in cause.candidates}


def summary_of(
    way: str, pixels: float, until: float, *, stated: bool = True, step_deg: float = 0.0
) -> dict[str, Any]:
    """What is written of a session whose right camera has crept by so much at its end.

    `until` 0: it stands turned from the middle on. `stated`: rig.toml tells its uncertainty, else
    it is exact and tells none. By `step_deg` joint 3 reads more from the middle on.
    """
    doubts = ScenarioUncertainty(focal_px=0.2, principal_point_px=0.2, led_mm=0.02)
    session = in_memory(
        scene(
            clock=ScenarioClock(), marker=marker_of("ABCD"),
            encoders=ScenarioEncoders(noise_deg=0.002),
            uncertainty=doubts if stated else None,
            motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6),
            recording=ScenarioRecording(pairs=60, rate_hz=7.5),
        )
    )  # fmt: skip
    readings = session.encoders
    late = np.outer(readings.t > readings.t.mean(), np.arange(6) == 2)
    read = replace(readings, q=readings.q + np.radians(step_deg) * late)
    session = replace(session, encoders=read)
    focal = session.simulated.world.bench.cameras[1].matrix[0, 0]
    angles = creep(session.frames.t_left, pixels / focal, until)
    spots, rng = camera_creeps(session, RIGHT, way, angles), np.random.default_rng(4)

    def measured(*_: Any) -> Iterator[Measurement]:
        systematics = stated_systematics(session.rig, session.marker, turning=False)
        for m in measured_at_spots(session, systematics, rng, spots=spots):
            posed = way == "pan" or (m.pose is not None and m.pose.consistent)
            yield m if posed else replace(m, status="outlier")

    limits = Tolerance(joints=np.radians([0.1] * 6), position=None, orientation=None)
    return analyse(session, tolerance=limits, chain=measured).summary | {
        "turn_deg": float(np.degrees(angles[-1]))
    }


@pytest.mark.parametrize("until", [EVENLY, STOPS])
def test_of_a_camera_that_creeps_no_joint_is_out_of_tolerance(until: float) -> None:
    summary = summary_of("pan", 1.5, until)
    (cause,) = summary["diagnosis"]
    assert (cause["kind"], cause["joint"], cause["unit"]) == ("camera_drift", None, "deg")
    assert_allclose(cause["value"], summary["turn_deg"], atol=1.25 * cause["expanded_uncertainty"])
    assert "nonconform" not in {joint["verdict"] for joint in summary["joints"]}
    for joint in summary["joints"]:
        assert abs(joint["mean_error_deg"]) < 1.5 * joint["expanded_uncertainty_deg"]


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(
    ("pixels", "until"), [(1.5, EVENLY), (1.5, AT_ONCE), (3.0, STOPS), (6.0, AT_ONCE)]
)
def test_a_camera_that_tilts_is_named_by_the_pictures_and_no_joint(
    pixels: float, until: float, stated: bool
) -> None:
    summary = summary_of("tilt", pixels, until, stated=stated)
    (cause,) = summary["diagnosis"]
    assert (cause["kind"], cause["joint"], cause["unit"]) == ("camera_tilted", None, "deg")
    assert_allclose(cause["value"], summary["turn_deg"], atol=1.25 * cause["expanded_uncertainty"])
    assert cause["expanded_uncertainty"] < 0.2 * cause["value"]
    assert ("t_s" in cause) == (until == AT_ONCE)
    (told,) = (w for w in summary["warnings"] if w.startswith("A camera was tilted"))
    assert f"by {cause['value']:.3f}°" in told
    assert "nonconform" not in {joint["verdict"] for joint in summary["joints"]}
    for joint in summary["joints"]:
        assert abs(joint["mean_error_deg"]) < 1.5 * joint["expanded_uncertainty_deg"]


def test_what_a_tilted_camera_does_is_a_source_of_uncertainty() -> None:
    summary = summary_of("tilt", 1.0, EVENLY)
    for joint in summary["budget"]["joints"]:
        (tilt,) = (s for s in joint["sources"] if s["source"] == "tilted camera")
        assert 0 < tilt["standard_uncertainty_deg"] < joint["systematic_standard_uncertainty_deg"]


def test_a_joint_that_steps_far_is_named_beside_a_tilted_camera() -> None:
    tilted, cause = summary_of("tilt", 1.0, EVENLY, step_deg=0.5)["diagnosis"]
    assert tilted["kind"] == "camera_tilted"
    assert (cause["kind"], cause["joint"]) == ("step", 3)
    assert_allclose(cause["value"], 0.5, atol=1.5 * cause["expanded_uncertainty"])
