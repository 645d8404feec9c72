"""A simulated session as `analyse` takes it, without a folder or a video between."""

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import robots
from verify.records import Array, StereoPair
from verify.series import Encoders, Frames
from verify.session import Clock, Session
from verify.sim.scenario import Scenario
from verify.sim.sessions import SimulatedSession, simulate


@dataclass(frozen=True)
class InMemory(Session):
    """A session whose pictures are rendered as they are asked for."""

    simulated: SimulatedSession

    def pairs(self) -> Generator[StereoPair]:
        """Render the pairs."""
        yield from self.simulated.pairs()

    @property
    def truth(self) -> Array:
        """True joint angles at each pair, (pairs, joints), rad."""
        return self.simulated.truth


def in_memory(scenario: Scenario) -> InMemory:
    """Play a scenario and hand it over as a session."""
    played = simulate(scenario)
    offset = played.clock_offset
    nowhere = Path("simulated")
    return InMemory(
        folder=nowhere,
        name="simulated",
        arm=robots.load(scenario.robot),
        robot=scenario.robot,
        description=scenario.description,
        started=None,
        open=False,
        rig=played.rig,
        marker=played.marker,
        clock=None if offset is None else Clock(offset, None),
        encoder_resolution=None,
        encoder_time_standard_uncertainty=None,
        tolerance=None,
        temperature_c=None,
        frames=Frames(played.t[:, 0], played.t[:, 1], played.pan[:, 0], played.pan[:, 1]),
        encoders=Encoders(played.encoder_t, np.asarray(played.encoder_q)),
        inputs={},
        warnings=(),
        left=None,  # type: ignore[arg-type]  # never opened: pairs() renders instead
        right=None,  # type: ignore[arg-type]
        simulated=played,
    )
