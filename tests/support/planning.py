"""A simulated bench to plan for, and the simulator made to play what was planned."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
import pytest

import robots
from tests.support.simulated import HOME_DEG, InMemory, in_memory, marker_of
from verify.core.records import Array
from verify.planning import roadmap
from verify.planning.plan import SessionPlan, plan_motion
from verify.planning.request import PlanningSetup, PlanRequest, SessionConditions
from verify.planning.selection import TimedMotion
from verify.simulation.scenario import (
    MultiJoint,
    Scenario,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioPlacement,
    ScenarioRecording,
    ScenarioRig,
    ScenarioUncertainty,
)
from verify.simulation.session import simulate

RATE = 4.0  # pairs a second
SPOT_NOISE_PX = 0.0055  # what the simulated pictures give: median of a run's spots

SCENARIO = Scenario(
    format=1,
    robot="iust_6r",
    seed=5,
    motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[10.0, 8.0, 10.0, 12.0, 12.0, 20.0]),
    recording=ScenarioRecording(pairs=20, rate_hz=RATE),
    rig=ScenarioRig(distance_mm=750.0),
    marker=marker_of("ABC"),
    encoders=ScenarioEncoders(),
    clock=ScenarioClock(),
    uncertainty=ScenarioUncertainty(
        focal_px=0.1, principal_point_px=0.1, camera_rotation_deg=0.002, base_position_mm=0.1,
        base_rotation_deg=0.01, led_body_mm=0.03, led_body_deg=0.02, led_mm=0.02,
    ),
)  # fmt: skip


@contextmanager
def few_postures() -> Iterator[None]:
    """A coarse roadmap, drawn from few postures: quick, and as good to test with."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(roadmap, "MAX_NODES", 150)
        patch.setattr(roadmap, "MIN_POSTURES", 60)
        patch.setattr(roadmap, "MAX_DRAWN", 40_000)
        yield


def bench() -> PlanningSetup:
    """What the user believes of the simulated cameras, arm and LEDs."""
    played = simulate.simulate_session(SCENARIO)
    return PlanningSetup(robots.load(SCENARIO.robot), played.rig, played.marker)


def wish(**changed: object) -> PlanRequest:
    """Few poses about the scenario's home."""
    near = np.deg2rad(HOME_DEG)
    usual: dict[str, object] = {"poses": 5, "near": near, "within": np.deg2rad(35.0)}
    return PlanRequest(**usual | changed)  # type: ignore[arg-type]  # keyword fields of the dataclass


def conditions(*, clock_uncertainty: float | None = 0.0) -> SessionConditions:
    return SessionConditions(
        rate=RATE, spot_noise=SPOT_NOISE_PX, clock_uncertainty=clock_uncertainty
    )  # fmt: skip


def planned(of: PlanningSetup, asked: PlanRequest, taken: SessionConditions) -> SessionPlan:
    return plan_motion(of, asked, taken, lambda _done, _all, _stage: None)


@dataclass(frozen=True)
class Played:
    """A plan as the simulator's motion, from the simulator's first pair on."""

    timed: TimedMotion

    def angles(self, t: Array) -> Array:
        t = np.asarray(t, dtype=float)
        return self.timed.q(t.reshape(-1) - simulate.START_OFFSET).reshape(*t.shape, -1)

    def direction(self, t: Array) -> Array:
        """Of no account where no encoder is at fault."""
        return np.ones((*np.shape(t), 6))


def recorded(
    of: PlanningSetup,
    made: SessionPlan,
    take: Callable[[object], None],
    scenario: Scenario = SCENARIO,
) -> InMemory:
    """The session that the simulator records of a plan, the cameras standing where they stood.

    `take` puts a function in the place of the simulator's own plan of a motion.
    """
    placed = of.rig.rig_T_base
    placement = ScenarioPlacement(
        base_rotation_deg=tuple(np.rad2deg(cv2.Rodrigues(placed[:3, :3])[0].ravel()).tolist()),
        base_position_mm=tuple((placed[:3, 3] * 1e3).tolist()),
        pan_deg=(float(np.rad2deg(of.rig.left.pan)), float(np.rad2deg(of.rig.right.pan))),
    )
    pairs = len(made.prediction.session.t)
    scenario = msgspec.structs.replace(
        scenario,
        recording=ScenarioRecording(pairs=pairs, rate_hz=RATE),
        rig=msgspec.structs.replace(scenario.rig, placement=placement),
    )
    take(lambda *_: Played(made.timed))
    return in_memory(scenario)
