"""A rig or robot base that creeps during the session, told from joints that drift.

The LEDs of every pair are projected into a rig that stands elsewhere each time; drifts of joints
are put into the readings.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tests.bench.diagnosis.sessions import judged, watched
from tests.support.leds.truth import led_images, true_spots
from tests.support.simulated import (
    HOME_DEG,
    InMemory,
    in_memory,
    marker_of,
    measured_at_spots,
    scene,
)
from verify.analysis.diagnosis.detectability import detectable
from verify.analysis.diagnosis.diagnose import Diagnosis
from verify.analysis.diagnosis.faults import UNIT_SCALES
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement
from verify.io.session.keys import Tolerance
from verify.measurement.systematics import stated_systematics
from verify.simulation.scenario import (
    MultiJoint,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioRecording,
)

# of the base, in its own axes at its origin: m and rad
SINKS, TILTS = (2e-4, -3e-4, 9e-4, 0.0, 0.0, 0.0), (-3e-4, -2e-4, 2e-4, 5e-4, -7e-4, 3e-4)


def creeping(session: InMemory, twist: Array) -> list[Array]:
    """Images of the LEDs, a side each, while the base moves by `twist` (6,) evenly."""
    played, spots = session.simulated, []
    share = (played.t[:, 0] - played.t[0, 0]) / np.ptp(played.t[:, 0])
    for side in (0, 1):
        images = []
        for i, part in enumerate(share.tolist()):
            moved = np.eye(4)
            moved[:3, :3] = Rotation.from_rotvec(part * twist[3:]).as_matrix()
            moved[:3, 3] = part * twist[:3]
            bench = played.world.bench
            bench = replace(bench, rig_T_base=bench.rig_T_base @ moved)
            place = float(played.t[i, side]), float(played.true_pan[i, side])
            images.append(led_images(replace(played.world, bench=bench), side, *place))
        spots.append(np.array(images))
    return spots


def crept(seed: int, twist: tuple[float, ...], pixels: float) -> tuple[Diagnosis, Array, Array]:
    """What is found where LEDs end up `pixels` away, joints' mean errors over u, and the twist."""
    case = watched(seed)
    true = [true_spots(case.session.simulated, side)[-1] for side in (0, 1)]
    ends = [spots[-1] for spots in creeping(case.session, np.array(twist))]
    size = pixels / np.median(np.linalg.norm(np.array(ends) - true, axis=2)) * np.array(twist)
    spots, noise = creeping(case.session, size), np.random.default_rng(case.noise)
    found = measured_at_spots(case.session, case.systematics, noise, spots=spots)
    _, seen, resolved = judged(replace(case, measurements=tuple(found)), None)
    return seen, resolved.mean / np.sqrt(np.diag(resolved.mean_covariance)), size


@pytest.mark.parametrize("seed", [1, 2, 5, 8])
@pytest.mark.parametrize("twist", [SINKS, TILTS], ids=["sinks", "tilts"])
@pytest.mark.parametrize("pixels", [1.0, 3.0])
def test_a_rig_that_creeps_is_named_and_no_joint(
    seed: int, twist: tuple[float, ...], pixels: float
) -> None:
    seen, off, size = crept(seed, twist, pixels)
    assert [(c.kind, c.joint) for c in seen.causes] == [("base_drift", None)]
    (cause,) = seen.causes
    assert abs(cause.value - np.linalg.norm(size[:3])) < 2.5 * cause.standard_uncertainty
    i = next(k for k, f in enumerate(seen.products.faults) if f.kind == "base_drift")
    values, covariance = seen.products.estimate((i,), i)
    assert (values - size) @ np.linalg.solve(covariance, values - size) < 22.5  # 0.1 % of chance
    assert np.abs(off[~np.isnan(off)]).max() < 4


@pytest.mark.parametrize("seed", [1, 2, 5, 8])
@pytest.mark.parametrize("twist", [SINKS, TILTS], ids=["sinks", "tilts"])
def test_of_half_a_pixel_no_joint_is_said_to_be_the_cause(
    seed: int, twist: tuple[float, ...]
) -> None:
    (cause,) = crept(seed, twist, 0.5)[0].causes
    assert "base_drift" in {cause.kind} | {k.kind for k in cause.candidates}


def drifting(seed: int, sizes_deg: tuple[float, ...]) -> Diagnosis:
    """What is found where joints' readings drift, deg over the session, a joint each."""
    case = watched(seed)
    return judged(replace(case, session=with_drift(case.session, sizes_deg)), None)[1]


def with_drift(session: InMemory, sizes_deg: tuple[float, ...]) -> InMemory:
    """A session whose readings go off evenly, from 0 at the first pair."""
    encoders, played = session.encoders, session.simulated
    t = encoders.t + played.scenario.encoders.clock_offset_s - played.t[0, 0]
    error = np.outer(t / np.ptp(played.t[:, 0]), np.radians(sizes_deg))
    return replace(session, encoders=replace(encoders, q=encoders.q + error))


@pytest.mark.parametrize("seed", [1, 2, 5, 8])
def test_joints_that_drift_clearly_are_no_base_that_creeps(seed: int) -> None:
    causes = drifting(seed, (0.0, 0.0, 0.4, 0.0, -0.4, 0.0)).causes
    assert {(c.kind, c.joint) for c in causes} == {("drift", 3), ("drift", 5)}


@pytest.mark.parametrize("seed", [1, 2, 5, 8])
@pytest.mark.parametrize(
    "sizes", [(0.07, 0.07, -0.09, -0.09, -0.06, 0.07), (0.03, 0.0, 0.0, 0.0, -0.06, 0.0)]
)
def test_of_joints_that_drift_a_little_the_base_is_never_said_to_creep(
    seed: int, sizes: tuple[float, ...]
) -> None:
    """Where that explains as much, it is a candidate beside them."""
    seen = drifting(seed, sizes)
    assert "base_drift" not in {c.kind for c in seen.causes}


def swinging() -> InMemory:
    return in_memory(
        scene(
            clock=ScenarioClock(), marker=marker_of("ABCD"),
            encoders=ScenarioEncoders(noise_deg=0.002),
            motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[20.0] * 6),
            recording=ScenarioRecording(pairs=60, rate_hz=7.5),
        )
    )  # fmt: skip


def summary_of(session: InMemory, twist: tuple[float, ...] = (0.0,) * 6) -> dict[str, Any]:
    """What is written of a session whose base has moved by `twist` at its end."""
    spots, rng = creeping(session, np.array(twist)), np.random.default_rng(4)

    def measured(*_: Any) -> Iterator[Measurement]:
        systematics = stated_systematics(session.rig, session.marker, turning=False)
        yield from measured_at_spots(session, systematics, rng, spots=spots)

    limits = Tolerance(joints=np.radians([0.1] * 6), position=None, orientation=None)
    return analyse(session, tolerance=limits, chain=measured).summary


def test_of_a_rig_that_creeps_no_joint_is_out_of_tolerance() -> None:
    twist = tuple(2 * x for x in TILTS)
    summary = summary_of(swinging(), twist)
    (cause,) = summary["diagnosis"]
    assert (cause["kind"], cause["joint"], cause["unit"]) == ("base_drift", None, "mm")
    shift, turn = 1e3 * np.linalg.norm(twist[:3]), np.degrees(np.linalg.norm(twist[3:]))
    assert_allclose(cause["value"], shift, atol=1.25 * cause["expanded_uncertainty"])
    assert_allclose(cause["turn_deg"], turn, rtol=0.1)
    assert "nonconform" not in {joint["verdict"] for joint in summary["joints"]}
    for joint in summary["joints"]:
        assert abs(joint["mean_error_deg"]) < 1.5 * joint["expanded_uncertainty_deg"]


def test_a_base_that_turns_about_the_first_axis_is_said_to_show_as_that_joint_s_drift() -> None:
    turn = 0.3
    drift = summary_of(with_drift(swinging(), (-turn, 0.0, 0.0, 0.0, 0.0, 0.0)))
    base = summary_of(swinging(), (0.0, 0.0, 0.0, 0.0, 0.0, np.radians(turn)))
    for summary in (drift, base):
        (cause,) = summary["diagnosis"]
        assert (cause["kind"], cause["joint"], cause["same_as"]) == ("drift", 1, "base_turned")
        rate = -turn * 3600 / (59 / 7.5)
        assert_allclose(cause["value"], rate, atol=1.25 * cause["expanded_uncertainty"])


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("kind", "rivals"),
    [("base_drift", "drift"), ("camera_drift", "drift"), ("camera_drift", "base_drift")],
)
def test_the_size_at_which_a_creep_is_named_counts_that_all_joints_may_drift_or_the_base(
    seed: int, kind: str, rivals: str
) -> None:
    """By plain algebra on the whitened rows, as of single rivals."""
    model, seen, _ = judged(watched(seed), None)
    drifts = np.hstack([f.columns for f in seen.products.faults if f.kind == rivals])
    creep = next(f for f in seen.products.faults if f.kind == kind)
    beside = np.hstack([drifts, model.fitted, model.prior])
    held = np.zeros((model.prior.shape[1], beside.shape[1]))
    held[:, drifts.shape[1] + model.fitted.shape[1] :] = np.eye(model.prior.shape[1])
    rows = np.vstack([beside, held])
    own = np.vstack([creep.columns, np.zeros((len(held), creep.freedom))])
    left = np.linalg.norm(own - rows @ np.linalg.lstsq(rows, own)[0], axis=0)[:3]
    table = detectable(seen.products)
    stated = table[table["kind"] == kind]["separable"].to_numpy()[:3]
    known = stated[~np.isnan(stated)]
    assert len(known)
    least = UNIT_SCALES[creep.unit] * (np.sqrt(15.0) + 0.84) / left
    assert np.all(known >= least[~np.isnan(stated)])
