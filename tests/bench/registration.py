"""Do base and LEDs from a motion lie as near the truth as they claim? Spot level, no rendering.

A replicate is one simulated session: true spots with white noise, encoders with theirs, base,
LEDs, clock and skew fitted. d² of base and LEDs against truth must follow chi².

    python -m tests.bench.registration [SESSIONS] [SEED]
"""

import sys
from collections.abc import Iterator

import numpy as np
from scipy.stats import chi2

from robots.transforms import difference
from tests.bench.cells import Checked, d2_ratio, seeds
from tests.support.leds.truth import true_spots
from tests.support.random_scenarios import random_scenario
from verify.calibration.registration.adjustment import AdjustedRegistration, AdjustmentSetup, adjust
from verify.calibration.registration.model import (
    RegistrationParameters,
    SpotStack,
    reading_variance,
)
from verify.core.readings import Readings
from verify.core.records import Array
from verify.core.rig import Rig
from verify.simulation.session.simulate import SimulatedSession, simulate_session

ARMS = ("iust_6r", "rv_3sd_melfa")
SESSIONS = 60  # an arm
SEED = 20261123  # fixed beforehand
PAIRS = 60
SIGMA_PX = 0.02


def spot_level(session: SimulatedSession, sigma: float, rng: np.random.Generator) -> SpotStack:
    """True spots with white noise of `sigma` px, which is also what is stated (0: 0.02)."""
    true = [true_spots(session, side) for side in (0, 1)]
    centres = [spots + sigma * rng.standard_normal(spots.shape) for spots in true]
    return spot_stack(session.rig, centres, session.t, session.pan, sigma or SIGMA_PX)


def spot_stack(rig: Rig, centres: list[Array], t: Array, pan: Array, sigma: float) -> SpotStack:
    """Spots known to `sigma` px.

    Args:
        rig: that saw them.
        centres: (n, LEDs, 2) a side, px; nan where an LED is not seen.
        t: (n, 2), s.
        pan: (n, 2), rad.
        sigma: of each coordinate.
    """
    parts: list[tuple[Array, ...]] = []
    for side, (camera, spots) in enumerate(zip((rig.left, rig.right), centres, strict=True)):
        pair, led = np.nonzero(np.isfinite(spots[:, :, 0]))
        camera_T_rig = np.array([camera.camera_T_rig(float(p)) for p in pan[pair, side]])
        own = t[pair, side], pan[pair, side], camera_T_rig
        parts.append((pair, np.full(len(pair), side), led, spots[pair, led], *own))
    pair, side, led, centre, t, pan, camera_T_rig = (
        np.concatenate(p) for p in zip(*parts, strict=True)
    )
    order = np.argsort(pair, kind="stable")
    return SpotStack(
        pair=pair[order],
        frame=np.arange(pair.max() + 1),
        side=side[order],
        led=led[order],
        centre=centre[order],
        covariance=np.tile(sigma**2 * np.eye(2), (len(pair), 1, 1)),
        t=t[order],
        pan=pan[order],
        camera_T_rig=camera_T_rig[order],
        used=np.ones(len(pair), dtype=bool),
    )


def adjusted(
    session: SimulatedSession, spotted: SpotStack, error: Array | float = 0.0
) -> AdjustedRegistration:
    """Register a played session whose readings carry a constant error (j,), rad."""
    readings = Readings(session.encoder_t, session.encoder_q + error)
    offset = session.scenario.encoders.clock_offset_s
    start = RegistrationParameters(session.rig.rig_T_base, session.marker.leds, offset, 0.0)
    variance = reading_variance(readings, None)
    setup = AdjustmentSetup(session.rig, session.world.arm, readings, variance, 0.0, None)
    return adjust(spotted, setup, start, np.ones(start.size, dtype=bool))


def squared(arm: str, seed: int) -> tuple[Checked, float]:
    """Base and LEDs against the truth, and chi² a degree of freedom."""
    rng = np.random.default_rng(seed)
    session = simulate_session(random_scenario(rng, arm, pairs=PAIRS))
    found = adjusted(session, spot_level(session, SIGMA_PX, rng))
    bench = session.world.bench
    leds = (found.at.leds - bench.leds).ravel()
    error = np.concatenate([difference(found.at.rig_T_base, bench.rig_T_base), leds])
    n = len(error)
    d2 = float(error @ np.linalg.solve(found.covariance[:n, :n], error))
    return Checked((), np.zeros(0), d2, n), found.chi2 / found.degrees_of_freedom


def lines(sessions: int = SESSIONS, seed: int = SEED) -> Iterator[str]:
    """Compare with chi², an arm a line."""
    for arm in ARMS:
        outcomes, left = zip(*(squared(arm, s) for s in seeds(seed, sessions)), strict=True)
        ratio, low, high = d2_ratio(outcomes)
        inside = np.mean([o.d2 < chi2.ppf(0.95, o.degrees) for o in outcomes])
        yield (
            f"{arm}: mean of d²/dof {ratio:.3f} (99 % of chi²: {low:.3f} to {high:.3f}); "
            f"{inside:.0%} within their 95 %; chi²/dof of the residuals "
            f"{np.mean(left):.3f}; {sessions} sessions of {PAIRS} pairs"
        )


if __name__ == "__main__":
    for line in lines(*map(int, sys.argv[1:])):
        print(line)
