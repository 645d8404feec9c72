"""Outcome of a registration: contents of rig and marker file, hold-out, decisions, warnings."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from verify.calibration.registration.adjustment import AdjustedRegistration, AdjustmentSetup, adjust
from verify.calibration.registration.model import predict_spots
from verify.calibration.registration.records import MotionRegistration, build_marker
from verify.calibration.registration.start import RegistrationStart
from verify.calibration.registration.uncertainty import (
    absorption,
    inherited_absorption,
    rig_covariance,
    visible_fractions,
)
from verify.calibration.stereo.records import rms
from verify.core.fiducials import Marker
from verify.errors import InputError, one_line
from verify.io import fiducials
from verify.io import rig as io_rig
from verify.io.session.session import Recording

N_BLOCKS = 10  # of a session, every other one registered, the rest judged
MIN_HELD_OUT_PAIRS = 5  # pairs in each half, or there is no holding out
MIN_REPORTED_MISFIT = 2.0  # chi² a degree of freedom
MAX_REFUSED_SHARE = 0.1  # of the spots, before it is worth a warning
MAX_REFUSED_OF_KEPT = 0.5  # of the spots of an LED whose place is kept: it is not there
MAX_LED_SIGMA = 3.0  # standard uncertainties that an LED may be from its place
MIN_SKEW_SIGMA = 4.0  # standard uncertainties by which the stamps must differ to be blamed


@dataclass(frozen=True, slots=True)
class FixedParameters:
    """What is held, not adjusted; and the known marker, held or not."""

    named: Marker | None  # gives the LEDs' names
    base: bool
    leds: Marker | None  # the marker with these LEDs; None: they are adjusted


def registration_outcome(
    recording: Recording,
    held: FixedParameters,
    adjusted: AdjustedRegistration,
    setup: AdjustmentSetup,
    start: RegistrationStart,
    diameter: float,
) -> MotionRegistration:
    """Turn an adjustment into the contents of rig and marker file and of the report.

    The diameter, m, is that of an LED, from its image. No pair is left out yet.
    """
    spotted, at = adjusted.spotted, adjusted.at
    marker = held.leds or build_marker(at.leds, diameter, held.named)
    before = inherited_absorption(recording.rig, base=held.base, leds=held.leds)
    covariance = rig_covariance(recording.rig, marker, adjusted, held_marker=held.leds is not None)
    if held.leds is not None:  # stated in the rig's covariance, with its correlation with the base
        marker = replace(marker, body_standard_uncertainty=None, led_standard_uncertainty=None)
    rig = replace(
        recording.rig,
        rig_T_base=at.rig_T_base,
        base_source=recording.rig.base_source if held.base else "motion",
        absorption=absorption(adjusted, before),
        covariance=covariance,
        registration=None,
    )
    marker = replace(marker, registration=None)
    digest = hashlib.sha256(io_rig.encode(rig) + fiducials.encode_marker(marker)).hexdigest()
    registration = f"sha256:{digest}"  # of what both files hold: they cannot be mixed up
    fit_rms, held_out = _hold_out_rms(adjusted, setup)
    shown = [float(np.sqrt(adjusted.covariance[k, k])) if adjusted.free[k] else None
             for k in (-2, -1)]  # fmt: skip
    return MotionRegistration(
        rig=replace(rig, registration=registration),
        marker=replace(marker, registration=registration),
        clock_offset=at.clock,
        clock_standard_uncertainty=shown[0],
        skew=at.skew,
        skew_standard_uncertainty=shown[1],
        visible_fractions=visible_fractions(adjusted, before),
        rms_px=rms(adjusted.predicted.residual[spotted.used]),
        fit_rms_px=fit_rms,
        held_out_rms_px=held_out,
        misfit=adjusted.chi2 / max(adjusted.degrees_of_freedom, 1),
        pairs_used=len(np.unique(spotted.pair[spotted.used])),
        left_out={},
        spots=spotted,
        residual=adjusted.predicted.residual,
        decisions=tuple(_decisions(recording, held, adjusted, diameter)),
        warnings=tuple(map(one_line, _warnings(adjusted, start, shown, marker.names))),
    )


def _hold_out_rms(
    adjusted: AdjustedRegistration, setup: AdjustmentSetup
) -> tuple[float | None, float | None]:
    """Register on every other block of the session: rms there and on the rest, px."""
    spotted = adjusted.spotted
    n = len(spotted)
    blocks = min(N_BLOCKS, n)
    judged = (np.arange(n) * blocks // n) % 2 == 1
    if min(int(judged.sum()), int((~judged).sum())) < MIN_HELD_OUT_PAIRS:
        return None, None
    on_rest = judged[spotted.pair]
    part = adjust(replace(spotted, used=spotted.used & ~on_rest), setup, adjusted.at, adjusted.free)
    predicted = predict_spots(spotted, setup.rig, setup.arm, setup.readings, part.at)
    fitted, held_out = (spotted.used & ~on_rest, spotted.used & on_rest)
    return rms(predicted.residual[fitted]), rms(predicted.residual[held_out])


def _decisions(
    recording: Recording,
    held: FixedParameters,
    adjusted: AdjustedRegistration,
    diameter: float,
) -> Iterator[str]:
    yield f"{len(adjusted.at.leds)} LEDs move together as one rigid body."
    if held.named is None:
        yield f"LED diameter {diameter * 1e3:.1f} mm, from its image."
    if held.base:
        yield "The robot base stands as rig.toml has it; the LEDs are fitted."
    if held.leds is not None:
        yield (
            "The LEDs stand as marker.toml has them; the base is fitted. What marker.toml states "
            "of their uncertainty moves to rig.toml, where its correlation with the base is kept."
        )
    if recording.clock is not None and not adjusted.free[-2]:
        yield "The clock offset stands as session.toml has it."
    elif not adjusted.free[-2]:
        yield "The motion does not show the clock offset: held."
    if not adjusted.free[-1]:
        yield ("The motion does not show a skew of the cameras beside their stamps: held at 0.")
    refused = int((~adjusted.spotted.used).sum())
    if refused:
        yield f"{refused} of {len(adjusted.spotted.used)} spots were rejected."
    if adjusted.inflation > 1:
        yield (
            f"Residuals are larger than noise, or correlated: variances multiplied by "
            f"{adjusted.inflation:.1f}."
        )


def refuse_misplaced_led(adjusted: AdjustedRegistration, marker: Marker) -> None:
    """Raise InputError for an LED of a marker that is kept, which the spots show elsewhere."""
    worst, share = _most_refused(adjusted)
    mine, seen = adjusted.spotted.led == worst, adjusted.predicted
    columns = seen.design[mine, :, 6 + 3 * worst : 9 + 3 * worst].reshape(-1, 3)
    away = np.linalg.norm(np.linalg.lstsq(columns, seen.residual[mine].reshape(-1))[0])
    if share > MAX_REFUSED_OF_KEPT and away > MAX_LED_SIGMA * (
        marker.led_standard_uncertainty or 0
    ):
        raise InputError(
            "--known-marker", f"puts LED {marker.names[worst]} {away * 1e3:.1f} mm from where the "
            "pictures show it", "a marker that is kept says where each LED sits",
            "Measure that LED's place again, or leave out --keep-leds.",
        )  # fmt: skip


def _most_refused(adjusted: AdjustedRegistration) -> tuple[int, float]:
    """The LED of whose spots most were refused, and the share of these."""
    led, refused = adjusted.spotted.led, ~adjusted.spotted.used
    share = np.bincount(led, refused) / np.maximum(np.bincount(led), 1)
    return int(np.argmax(share)), float(share.max())


def _warnings(
    adjusted: AdjustedRegistration,
    start: RegistrationStart,
    shown: list[float | None],
    names: tuple[str, ...],
) -> Iterator[str]:
    if start.rivals:
        others = ", ".join(f"{o:+.3f}" for o in start.rivals[:4])
        yield (
            f"The motion repeats itself: the readings' clock could as well be off by {others} s. "
            "State [clock] encoder_offset_s, or add a movement that does not repeat."
        )
    skew, u = adjusted.at.skew, shown[1]
    if u is not None and abs(skew) > MIN_SKEW_SIGMA * u:
        yield (
            f"The right camera's stamps are {skew * 1e3:+.2f} ms ± {2 * u * 1e3:.2f} ms (k = 2) "
            "early against the left one's: add that to t_right_s in frames.csv."
        )
    refused = ~adjusted.spotted.used
    if refused.mean() > MAX_REFUSED_SHARE:
        worst, share = _most_refused(adjusted)
        yield (
            f"{int(refused.sum())} of {len(refused)} spots contradict the others and were "
            f"rejected, of LED {names[worst]} {share:.0%}: check its place, and what hides or "
            "mirrors it."
        )
    misfit = adjusted.chi2 / max(adjusted.degrees_of_freedom, 1)
    if misfit > MIN_REPORTED_MISFIT:
        yield (
            f"The residuals are {np.sqrt(misfit):.1f} times what noise explains: the robot's "
            "joints or its table are off, or the rig is; uncertainties are enlarged by it."
        )
