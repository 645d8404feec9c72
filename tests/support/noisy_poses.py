"""Measurements of a simulated session from its true spots with white noise, without pictures."""

from collections.abc import Iterator

import numpy as np

import robots
from tests.support.scene import sighting
from tests.support.simulated import InMemory
from verify.core.records import Array, Measurement, Sighting
from verify.measurement.pose import fit_pose
from verify.measurement.systematics import Systematics, spot_columns
from verify.simulation.session.simulate import SimulatedSession

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
    spots = spots or [played.spots(side) for side in (0, 1)]
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
