"""What is true of a simulated session, in words."""

import numpy as np

from verify.sim.scenario import Fault, Uncertainty
from verify.sim.sessions import SimulatedSession


def readme(session: SimulatedSession) -> str:
    """Write the session's README.md: what it shows, what is true, how the pictures came about."""
    scenario, image = session.scenario, session.scenario.image
    spans = ", ".join(f"{span:.1f}" for span in np.degrees(np.ptp(session.truth, axis=0)))
    distance = np.linalg.norm(session.world.led_points(session.t[:, 0]), axis=-1)
    bases = "follow the LEDs" if scenario.rig.bases == "follow" else "stand still"
    return f"""# {scenario.description or session.world.arm.name}

A simulated session ({session.world.arm.name}, seed {scenario.seed}), made by `verify simulate`.

{len(session)} pairs at {scenario.recording.rate_hz:g} per second; motion: \
{scenario.motion.__struct_config__.tag}, joint spans {spans} deg. {len(scenario.marker.led)} LEDs, \
{distance.min():.2f} to {distance.max():.2f} m from the rig. The cameras stand \
{scenario.rig.baseline_mm:g} mm apart; their bases {bases}. The right camera fires \
{1000 * scenario.recording.skew_s:g} ms after the left, with \
{1000 * scenario.recording.skew_jitter_s:g} ms of jitter (both times stand in frames.csv).

## Truth

{_faults(scenario.fault)}
{_clock(session)}
Encoders: {scenario.encoders.rate_hz:g} Hz, noise {scenario.encoders.noise_deg:g} deg, \
resolution {scenario.encoders.resolution_deg:g} deg.
{_belief(scenario.uncertainty)}
`truth.csv` holds the joints at each pair's left time; no measurement reads it.

## Pictures

LEDs are evenly bright discs of {scenario.marker.led_diameter_mm:g} mm that face the camera, \
blurred by {image.blur_px:g} px (standard deviation). A pixel is its light, shot noise \
({image.electrons_per_dn:g} electrons per DN), read noise ({image.read_noise_dn:g} DN) and a black \
level of {image.black_level_dn:g} DN, rounded to 0 … 255.
"""


def _faults(faults: list[Fault]) -> str:
    if not faults:
        return "No encoder is at fault."
    lines = []
    for fault in faults:
        parts = []
        if fault.offset_deg:
            parts.append(f"offset {fault.offset_deg:+g} deg")
        if fault.gain:
            parts.append(f"gain {fault.gain:+g}")
        if fault.backlash_deg:
            parts.append(f"backlash {fault.backlash_deg:+g} deg")
        if fault.eccentricity_deg:
            parts.append(
                f"eccentricity {fault.eccentricity_deg:g} deg, phase {fault.phase_deg:g} deg, "
                f"{fault.per_turn} per turn"
            )
        lines.append(f"The encoder of joint {fault.joint} is at fault: {'; '.join(parts)}.")
    return "\n".join(lines)


def _clock(session: SimulatedSession) -> str:
    encoders = session.scenario.encoders
    said = "does not say so" if session.clock_offset is None else "says so"
    if session.clock_offset is not None and session.clock_offset != encoders.clock_offset_s:
        said = f"says {session.clock_offset:.6f} s"
    drift = f", growing by {encoders.clock_drift_ppm:g} ppm" if encoders.clock_drift_ppm else ""
    return (
        f"Add {encoders.clock_offset_s:g} s{drift} to the encoders' time to get the cameras'; "
        f"`session.toml` {said}."
    )


def _belief(stated: Uncertainty | None) -> str:
    if stated is None:
        return "`rig.toml` and `marker.toml` are exact and state no uncertainty."
    if not stated.draw:
        return "`rig.toml` and `marker.toml` are exact, and state uncertainties all the same."
    return (
        "The true cameras, base and LEDs lie off what `rig.toml` and `marker.toml` say, by one "
        "draw from the standard uncertainties that these state."
    )
