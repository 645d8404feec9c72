"""A simulated session as `analyse` takes it, without a folder or a video between.

Small scenarios that several tests start from.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
from msgspec.inspect import ListType, StructType, UnionType, type_info

import robots
from tests.support.leds.truth import true_spots
from tests.support.scene import sighting
from verify.core.records import Array, Measurement, Sighting, StereoPair
from verify.io.series import EncoderSeries, FrameSeries
from verify.io.session.keys import Clock
from verify.io.session.session import Session
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import Systematics, spot_columns
from verify.simulation import library
from verify.simulation.scenario import (
    MultiJoint,
    Scenario,
    ScenarioCamera,
    ScenarioEncoders,
    ScenarioLed,
    ScenarioMarker,
    ScenarioRecording,
)
from verify.simulation.session.simulate import SimulatedSession, simulate_session

# a camera with nothing upright or in the middle
AWKWARD = ScenarioCamera(
    focal_px=(1012.4, 1003.7), principal_point_px=(655.0, 341.0),
    distortion=(-0.12, 0.08, 0.002, -0.003, 0.02), pan_axis=(0.05, 0.99, -0.08), pan_zero_deg=1.7,
    mount_rotation_deg=(3.0, -2.0, 2.0), mount_offset_mm=(4.0, -6.0, 12.0),
)  # fmt: skip


def rendered(session: SimulatedSession) -> Iterator[StereoPair]:
    """Render all pairs of a session, one at a time."""
    for index, (times, pans) in enumerate(
        zip(session.t.tolist(), session.pan.tolist(), strict=True)
    ):
        yield StereoPair(index, *times, *pans, session.image(0, index), session.image(1, index))


@dataclass(frozen=True)
class InMemory(Session):
    """A session whose pictures are rendered as they are asked for."""

    simulated: SimulatedSession

    def pairs(self) -> Generator[StereoPair]:
        """Render the pairs; pan readings are the session's."""
        pans = zip(self.frames.pan_left.tolist(), self.frames.pan_right.tolist(), strict=True)
        for pair, (left, right) in zip(rendered(self.simulated), pans, strict=True):
            yield replace(pair, pan_left=left, pan_right=right)

    @property
    def truth(self) -> Array:
        """True joint angles at each pair, (pairs, joints), rad."""
        return self.simulated.truth


def in_memory(scenario: Scenario) -> InMemory:
    """Play a scenario and hand it over as a session."""
    played = simulate_session(scenario)
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
        certificate={},
        frames=FrameSeries(played.t[:, 0], played.t[:, 1], played.pan[:, 0], played.pan[:, 1]),
        encoders=EncoderSeries(played.encoder_t, np.asarray(played.encoder_q)),
        inputs={},
        warnings=(),
        left=SimpleNamespace(path=nowhere / "left.mkv"),  # type: ignore[arg-type]  # never opened:
        right=SimpleNamespace(path=nowhere / "right.mkv"),  # type: ignore[arg-type]  # rendered
        simulated=played,
    )


SPOT_PX = 0.03


def measured_at_spots(
    session: InMemory,
    systematics: Systematics,
    rng: np.random.Generator,
    spots: list[Array] | None = None,
    sigma: float = SPOT_PX,
) -> Iterator[Measurement]:
    """Fit a pose to the spots of each pair; `spots`, px, (n, LEDs, 2) a side, replace true ones."""
    rig, marker, played = session.rig, session.marker, session.simulated
    spots = spots or [true_spots(played, side) for side in (0, 1)]
    for i, q in enumerate(session.truth):
        left, right = (_sighting(played, spots[side][i], side, i, rng, sigma) for side in (0, 1))

        def columns(
            pose: Array, by_point: Array, pair: tuple[Sighting, Sighting] = (left, right)
        ) -> Array:
            return spot_columns(systematics, rig, marker, *pair, pose, by_point)

        start: Array = rig.rig_T_base @ robots.forward(session.arm, q)
        pose = fit_pose(left, right, rig, marker, start, columns)
        yield Measurement(i, left.t, "measured", len(marker), pose, left, right)


def _sighting(
    played: SimulatedSession, centre: Array, side: int, index: int, rng: np.random.Generator,
    sigma: float,
) -> Sighting:  # fmt: skip
    noisy = centre + sigma * rng.standard_normal(centre.shape)
    t, pan = float(played.t[index, side]), float(played.pan[index, side])
    return sighting(list(range(len(centre))), noisy, sigma, t, pan)


HOME_DEG = [30.0, -62.0, 46.0, 8.0, -84.0, 24.0]


LEDS = {
    "A": (60.0, 5.0, 20.0),
    "B": (-50.0, 36.0, 12.0),
    "C": (-20.0, -55.0, 28.0),
    "D": (26.0, 52.0, 36.0),
}  # mm


def marker_of(names: str) -> ScenarioMarker:
    return ScenarioMarker(led=[ScenarioLed(name=n, position_mm=LEDS[n]) for n in names])


def scene(**changes: Any) -> Scenario:
    """A short multi-joint session of the 6R arm; keyword arguments replace whole tables."""
    plain = Scenario(
        format=1,
        robot="iust_6r",
        seed=5,
        motion=MultiJoint(home_deg=HOME_DEG, amplitude_deg=[10.0] * 6),
        recording=ScenarioRecording(pairs=12, rate_hz=10.0),
        marker=marker_of("ABC"),
        encoders=ScenarioEncoders(noise_deg=0.0),
    )
    return msgspec.structs.replace(plain, **changes)


def sample(**recording: Any) -> Scenario:
    """The built-in session with a fault of joint 2, its recording changed."""
    built = library.load("multi_joint_fault_6r")
    changed = msgspec.structs.replace(built.recording, **recording)
    return msgspec.structs.replace(built, recording=changed)


def played(**changes: Any) -> SimulatedSession:
    """That session, played."""
    return simulate_session(scene(**changes))


MINIMAL = """
format = 1
robot = "iust_6r"
seed = 1
[motion]
kind = "multi_joint"
home_deg = [30.0, -62.0, 46.0, 8.0, -84.0, 24.0]
amplitude_deg = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0]
[recording]
pairs = 3
rate_hz = 10.0
[[marker.led]]
name = "A"
position_mm = [60.0, 5.0, 20.0]
"""
SMALL_BOARDS = """format = 1
seed = 5

[boards]
pairs = {pairs}
inner_corners = [9, 6]
distance_mm = [650.0, 1300.0]

[rig]
image_size = [640, 360]

[rig.left]
focal_px = [506.2, 505.5]
principal_point_px = [323.1, 177.6]
distortion = [-0.085, 0.06, 0.0006, -0.0004, 0.0]

[rig.right]
focal_px = [504.3, 503.9]
principal_point_px = [317.4, 181.8]
distortion = [-0.079, 0.052, -0.0005, 0.0007, 0.0]
"""
FIXTURE = """
[fixture]
board_rotation_deg = [-63.9, -45.5, 70.8]
board_position_mm = [150.0, -105.0, 320.0]
base_rotation_deg = [77.4, 64.4, -53.8]
base_position_mm = [0.0, 250.0, 1150.0]
"""


def keys_of(scenario: type[msgspec.Struct]) -> set[str]:
    """Every key that a scenario's file may hold, as TABLE.KEY."""
    keys: set[str] = set()
    waiting: list[Any] = [type_info(scenario)]
    while waiting:
        match waiting.pop():
            case StructType(cls=cls, fields=fields):
                keys |= {f"{cls.__name__}.{field.encode_name}" for field in fields}
                waiting += [field.type for field in fields]
            case ListType(item_type=item):
                waiting.append(item)
            case UnionType(types=types):
                waiting += types
    return keys
