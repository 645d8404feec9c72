"""Simulated sessions of rigs that were only proposed: worlds drawn about what these state."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import pytest

import robots
from tests.support.leds.truth import true_spots
from tests.support.planning import Played, few_postures, planned
from tests.support.scene import sighting
from tests.support.simulated import InMemory, in_memory
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement, Sighting
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import spot_columns, stated_systematics
from verify.planning.plan import SessionPlan
from verify.planning.proposal import (
    TYPICAL_UNCERTAINTIES,
    ProposedRig,
    build_setup,
    work_posture,
)
from verify.planning.request import PlanningSetup, PlanRequest, SessionConditions
from verify.simulation.scenario import (
    MultiJoint,
    Scenario,
    ScenarioCamera,
    ScenarioClock,
    ScenarioEncoders,
    ScenarioLed,
    ScenarioMarker,
    ScenarioPlacement,
    ScenarioRecording,
    ScenarioRig,
    ScenarioUncertainty,
)

RATE = 2.0  # pairs a second
SPOT_NOISE_PX = 0.05
SIMULATED = {name: u for name, u in TYPICAL_UNCERTAINTIES.items() if name != "led_centre_mm"}
PLAN_MOTION = "verify.simulation.session.simulate.plan_motion"


@dataclass(frozen=True)
class Proposal:
    """A rig, its best motion and what is predicted of it."""

    robot: str
    rig: ProposedRig
    setup: PlanningSetup
    made: SessionPlan

    def scenario(self, seed: int) -> Scenario:
        """Describe it to the simulator in the simulator's own words."""
        arm, rig, placed = self.setup.arm, self.rig, self.setup.rig.rig_T_base
        width, height = rig.image_size
        focal = width / 2 / np.tan(rig.field_of_view / 2)
        camera = ScenarioCamera(
            focal_px=(focal, focal), principal_point_px=((width - 1) / 2, (height - 1) / 2)
        )
        turn = float(np.rad2deg(np.arctan(rig.baseline / 2 / rig.distance)))
        names = self.setup.marker.names
        home = np.rad2deg(self.made.timed.stops[0].q).tolist()
        return Scenario(
            format=1,
            robot=self.robot,
            seed=seed,
            motion=MultiJoint(home_deg=home, amplitude_deg=[0.1] * arm.dof),  # not played
            recording=ScenarioRecording(pairs=len(self.made.prediction.session.t), rate_hz=RATE),
            rig=ScenarioRig(
                image_size=rig.image_size,
                baseline_mm=rig.baseline * 1e3,
                placement=ScenarioPlacement(
                    base_rotation_deg=tuple(np.rad2deg(cv2.Rodrigues(placed[:3, :3])[0].ravel())),
                    base_position_mm=tuple(placed[:3, 3] * 1e3),
                    pan_deg=(turn, -turn),
                ),
                left=camera,
                right=camera,
            ),
            marker=ScenarioMarker(
                led=[
                    ScenarioLed(name=name, position_mm=tuple(place * 1e3))
                    for name, place in zip(names, self.setup.marker.leds, strict=True)
                ]
            ),
            encoders=ScenarioEncoders(),
            clock=ScenarioClock(),
            uncertainty=ScenarioUncertainty(**SIMULATED),
        )


def proposal(robot: str, rig: ProposedRig, poses: int = 6) -> Proposal:
    """Plan a short motion, few postures drawn, for a rig whose LEDs shine from their middle."""
    arm = robots.load(robot)
    rig = replace(rig, uncertainties=SIMULATED | {"led_centre_mm": 0.0})
    work = work_posture(arm, 0.0)
    setup = build_setup(arm, rig, work, 0.0)
    request = PlanRequest(poses=poses, observe=("offsets",), near=work, hold=0.2)
    taken = SessionConditions(rate=RATE, spot_noise=SPOT_NOISE_PX, clock_uncertainty=0.0)
    with few_postures():
        return Proposal(robot, rig, setup, planned(setup, request, taken))


def measured_means(one: Proposal, seed: int) -> Array:
    """Mean errors (j,), rad, that a sound arm shows in one world: errors of the measurement."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PLAN_MOTION, lambda *_: Played(one.made.timed))
        session = in_memory(one.scenario(seed))
    np.testing.assert_allclose(session.rig.rig_T_base, one.setup.rig.rig_T_base, atol=1e-9)
    for side in ("left", "right"):
        ours, theirs = getattr(one.setup.rig, side), getattr(session.rig, side)
        places = [camera.rig_T_camera(camera.pan) for camera in (ours, theirs)]
        np.testing.assert_allclose(*places, atol=1e-9)
        np.testing.assert_allclose(ours.matrix, theirs.matrix)
    summary = analyse(session, chain=partial(_chain, session, one, seed)).summary
    return np.deg2rad([joint["mean_error_deg"] for joint in summary["joints"]])


def _chain(session: InMemory, one: Proposal, seed: int, *_: object) -> Iterator[Measurement]:
    """Fit poses to the true images, with noise, of the LEDs that the plan has in view."""
    rng, rig, marker = np.random.default_rng(seed), session.rig, session.marker
    stated = stated_systematics(rig, marker, turning=False)
    true = [true_spots(session.simulated, side) for side in (0, 1)]
    for i, q in enumerate(session.truth):
        planned_pair = one.made.prediction.session.measurements[i]
        sides = planned_pair.left, planned_pair.right
        left, right = (
            sighting(
                led := side.led.tolist(),
                spots[i][led] + SPOT_NOISE_PX * rng.standard_normal((len(led), 2)),
                SPOT_NOISE_PX, float(session.simulated.t[i, 0]), camera.pan,
            )
            for side, spots, camera in zip(sides, true, (rig.left, rig.right), strict=True)
        )  # fmt: skip

        def columns(
            pose: Array, by_point: Array, pair: tuple[Sighting, Sighting] = (left, right)
        ) -> Array:
            return spot_columns(stated, rig, marker, *pair, pose, by_point)

        start: Array = rig.rig_T_base @ robots.forward(session.arm, q)
        pose = fit_pose(left, right, rig, marker, start, columns)
        yield Measurement(i, left.t, "measured", len(left.led), pose, left, right)
