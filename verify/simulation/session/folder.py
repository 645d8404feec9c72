"""Write a simulated session as a folder: docs/session.md's files, the truth, and a README."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from verify.core.records import Array, Image
from verify.io import fiducials, rig, toml
from verify.io.files import read_bytes
from verify.simulation.library import ROBOT_FILES
from verify.simulation.scenario import ScenarioFault, ScenarioUncertainty
from verify.simulation.session.simulate import SimulatedSession
from verify.simulation.session.video import write_video
from verify.simulation.world.led_render import SIDES


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


def _faults(faults: list[ScenarioFault]) -> str:
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


def _belief(stated: ScenarioUncertainty | None) -> str:
    if stated is None:
        return "`rig.toml` and `marker.toml` are exact and state no uncertainty."
    if not stated.draw:
        return "`rig.toml` and `marker.toml` are exact, and state uncertainties all the same."
    return (
        "The true cameras, base and LEDs lie off what `rig.toml` and `marker.toml` say, by one "
        "draw from the standard uncertainties that these state."
    )


START_TIME = datetime(
    2026, 1, 15, 9, 0, tzinfo=UTC
)  # any will do; a fixed one keeps bytes the same
RESERVED_NAMES = {
    "session.toml",
    "rig.toml",
    "marker.toml",
}  # names that a robot's file cannot have


def write_session(
    session: SimulatedSession, folder: Path, done: Callable[[], object] = lambda: None
) -> None:
    """Write every file of the session, pictures included, into an empty folder.

    Args:
        session: from `simulate`.
        folder: exists; what builds a folder whole or not at all is verify.io.files.
        done: called after each picture, for a progress bar.

    Raises:
        InputError: the disk refuses, or OpenCV cannot write the video.
    """
    write_tables(session, folder)
    for side in range(2):
        _write_pictures(session, side, folder, done)


def write_tables(session: SimulatedSession, folder: Path) -> None:
    """Write all but the pictures."""
    joints = session.world.arm.dof
    columns = ",".join(f"q{k}_deg" for k in range(1, joints + 1))
    robot = _copy_robot(session, folder)
    (folder / "session.toml").write_bytes(toml.encode(_session_table(session, robot)))
    rig.write(folder / "rig.toml", session.rig)
    fiducials.write_marker(folder / "marker.toml", session.marker)
    _write_frames(session, folder / "frames.csv")
    table = np.column_stack([session.encoder_t, np.degrees(session.encoder_q)])
    _write_csv(folder / "encoders.csv", f"t_s,{columns}", table, ["%.6f"] + ["%.6f"] * joints)
    table = np.column_stack([np.arange(len(session)), np.degrees(session.truth)])
    _write_csv(folder / "truth.csv", f"frame,{columns}", table, ["%d"] + ["%.9f"] * joints)
    (folder / "README.md").write_text(readme(session), encoding="utf-8", newline="\n")


def _copy_robot(session: SimulatedSession, folder: Path) -> str:
    """Copy a robot's own file into the folder, which must not reach outside; say how to name it."""
    robot = session.scenario.robot
    if Path(robot).suffix not in ROBOT_FILES:
        return robot
    name = (
        Path(robot).name if Path(robot).name not in RESERVED_NAMES else f"robot_{Path(robot).name}"
    )
    (folder / name).write_bytes(read_bytes(Path(robot)))
    return name


def _session_table(session: SimulatedSession, robot: str) -> dict[str, Any]:
    scenario = session.scenario
    table: dict[str, Any] = {
        "format": 1,
        "robot": robot,
        "description": scenario.description,
        "started": START_TIME,
        "rig": "rig.toml",
        "marker": "marker.toml",
        **{side: _stream(session, side) for side in SIDES},
        "frames": "frames.csv",
        "encoders": "encoders.csv",
    }
    if scenario.clock is not None:
        u = scenario.clock.encoder_offset_standard_uncertainty_s
        table["clock"] = {
            "encoder_offset_s": session.clock_offset,
            "encoder_offset_standard_uncertainty_s": u or None,
        }
    if scenario.encoders.resolution_deg > 0:
        table["encoder_readings"] = {"resolution_deg": scenario.encoders.resolution_deg}
    if scenario.tolerance is not None:
        table["tolerance"] = {
            "joints_deg": scenario.tolerance.joints_deg,
            "position_mm": scenario.tolerance.position_mm,
            "orientation_deg": scenario.tolerance.orientation_deg,
        }
    return table


def _stream(session: SimulatedSession, side: str) -> str:
    return f"{side}.mkv" if session.scenario.recording.format == "video" else side


def _write_frames(session: SimulatedSession, path: Path) -> None:
    header, formats = "frame,t_left_s,t_right_s", ["%d", "%.6f", "%.6f"]
    table = np.column_stack([np.arange(len(session)), session.t])
    if session.scenario.rig.bases == "follow":  # else rig.toml's pan_deg serves every pair
        header, formats = f"{header},pan_left_deg,pan_right_deg", [*formats, "%.6f", "%.6f"]
        table = np.column_stack([table, np.degrees(session.pan)])
    _write_csv(path, header, table, formats)


def _write_csv(path: Path, header: str, table: Array, formats: list[str]) -> None:
    row = ",".join(formats)
    lines = [header, *(row % tuple(values) for values in table.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _write_pictures(
    session: SimulatedSession, side: int, folder: Path, done: Callable[[], object]
) -> None:
    def pictures() -> Iterator[Image]:
        for index in range(len(session)):
            yield session.image(side, index)
            done()

    target = folder / _stream(session, SIDES[side])
    if session.scenario.recording.format == "video":
        write_video(target, pictures(), session.scenario.recording.rate_hz)
        return
    target.mkdir()
    for index, image in enumerate(pictures()):
        encoded = cv2.imencode(".png", image)[1]
        (target / f"{index:06d}.png").write_bytes(encoded.tobytes())
