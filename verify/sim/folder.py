"""Write a simulated session as a folder: docs/session.md's files, the truth, and a README."""

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from verify import marker_file, rig_file, toml_file
from verify.files import read_bytes
from verify.records import Array, Image
from verify.sim.library import ROBOT_FILES
from verify.sim.lights import SIDES
from verify.sim.readme import readme
from verify.sim.sessions import SimulatedSession
from verify.sim.video import write_video

STARTED = datetime(2026, 1, 15, 9, 0, tzinfo=UTC)  # any will do; a fixed one keeps bytes the same
OURS = {"session.toml", "rig.toml", "marker.toml"}  # names that a robot's file cannot have


def write(
    session: SimulatedSession, folder: Path, done: Callable[[], object] = lambda: None
) -> None:
    """Write every file of the session, pictures included, into an empty folder.

    Args:
        session: from `simulate`.
        folder: exists; what builds a folder whole or not at all is verify.writing.
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
    robot = _keep_robot(session, folder)
    (folder / "session.toml").write_bytes(toml_file.encode(_session_table(session, robot)))
    rig_file.write(folder / "rig.toml", session.rig)
    marker_file.write(folder / "marker.toml", session.marker)
    _write_frames(session, folder / "frames.csv")
    table = np.column_stack([session.encoder_t, np.degrees(session.encoder_q)])
    _write_csv(folder / "encoders.csv", f"t_s,{columns}", table, ["%.6f"] + ["%.6f"] * joints)
    table = np.column_stack([np.arange(len(session)), np.degrees(session.truth)])
    _write_csv(folder / "truth.csv", f"frame,{columns}", table, ["%d"] + ["%.9f"] * joints)
    (folder / "README.md").write_text(readme(session), encoding="utf-8", newline="\n")


def _keep_robot(session: SimulatedSession, folder: Path) -> str:
    """Copy a robot's own file into the folder, which must not reach outside; say how to name it."""
    robot = session.scenario.robot
    if Path(robot).suffix not in ROBOT_FILES:
        return robot
    name = Path(robot).name if Path(robot).name not in OURS else f"robot_{Path(robot).name}"
    (folder / name).write_bytes(read_bytes(Path(robot)))
    return name


def _session_table(session: SimulatedSession, robot: str) -> dict[str, Any]:
    scenario = session.scenario
    table: dict[str, Any] = {
        "format": 1,
        "robot": robot,
        "description": scenario.description,
        "started": STARTED,
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
