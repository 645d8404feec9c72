"""The noise of an instrument that does not state it, from the data's own scatter."""

import numpy as np
from numpy.typing import NDArray

from verify.alignment import LONGEST_GAP
from verify.comparison import compare
from verify.instrument import Noise, noise_of
from verify.readings import Readings
from verify.records import Array
from verify.session import Instrument, Session
from verify.track import Track

WINDOW = 5  # poses in a row that a parabola is laid through: two are left over
FEWEST_WINDOWS = 12  # for a scatter that is worth the name
MEDIAN_CHI2 = 5.348  # of six degrees of freedom: two that are left over, of three coordinates
MEDIAN_DOUBT = 1.3  # a variance from a median of squares is less certain than one from their mean
PARTS = (slice(0, 3), slice(3, 6))  # translation and rotation of a twist


def scattered(
    session: Session, instrument: Instrument, track: Track, readings: Readings, offset: float
) -> Noise | None:
    """Noise that is not stated, from the data's own scatter about the readings.

    How far the poses lie from where the readings put them changes slowly, whatever is wrong with
    the robot; a parabola through five in a row leaves the noise. The median over all windows keeps
    single jumps out; the readings' own share is taken off.

    Args:
        session: whose robot was measured.
        instrument: with noise that is not, or not all, stated.
        track: its poses.
        readings: the robot's own.
        offset: s, of their clock.

    Returns:
        All of the noise; None where poses are too few, or too far apart in time, to show it.
    """
    comparison = compare(
        track, session.arm, readings, offset, resolution=session.encoder_resolution
    )
    first = _windows(comparison.t)
    if len(first) < FEWEST_WINDOWS:
        return None
    # at the measured point: of positions alone, nothing else is known
    point = instrument.flange_T_body[:, 3]
    off = comparison.xi.copy()
    off[:, :3] = ((comparison.base_T_encoder - comparison.base_T_measured) @ point)[:, :3]
    left = _left_over(comparison.t, off, first)
    of_readings = comparison.covariance - comparison.covariance_measured
    doubt = MEDIAN_DOUBT * np.sqrt(
        2 / (2 * 3 * len(comparison) / WINDOW)
    )  # of a variance, relative
    sigma = []
    for part, least in zip(PARTS, instrument.poses.rounding, strict=True):
        share = np.trace(of_readings[:, part, part], axis1=1, axis2=2).mean() / 3
        total = np.median(left[:, part].sum(axis=1)) / MEDIAN_CHI2
        # noise that drowns in the readings' own may be as large as the doubt of the difference
        sigma.append(float(np.sqrt(max(total - share, doubt * total, least**2))))
    noise = noise_of(instrument)
    return Noise(
        noise.position if noise.position_known else np.full_like(noise.position, sigma[0]),
        noise.orientation if noise.orientation_known else np.full_like(noise.orientation, sigma[1]),
        position_known=True,
        orientation_known=True,
    )


def _windows(t: Array) -> NDArray[np.int64]:
    """Where WINDOW poses follow each other without a gap: the first of each, (w,)."""
    if len(t) < WINDOW:
        return np.zeros(0, dtype=np.int64)
    close = np.lib.stride_tricks.sliding_window_view(np.diff(t) <= LONGEST_GAP, WINDOW - 1)
    return np.flatnonzero(close.all(axis=1))


def _left_over(t: Array, values: Array, first: NDArray[np.int64]) -> Array:
    """Sums of squares that a parabola in time leaves of (n, 6) values in each window, (w, 6)."""
    rows = first[:, None] + np.arange(WINDOW)
    at = t[rows] - t[rows].mean(axis=1, keepdims=True)
    at /= np.abs(at).max(axis=1, keepdims=True)
    basis = np.linalg.qr(np.stack([np.ones_like(at), at, at**2], axis=2))[0]
    inside = values[rows]
    left = inside - basis @ (np.swapaxes(basis, 1, 2) @ inside)
    squares: Array = np.sum(left**2, axis=1)
    return squares
