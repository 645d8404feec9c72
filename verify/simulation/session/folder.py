"""Write a simulated session as a folder: docs/session.md's files, the truth, and a README."""

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import jinja2
import msgspec
import numpy as np

from verify.core.records import SIDES, Array, Image
from verify.errors import InputError
from verify.io import fiducials, rig, toml
from verify.io.board.folder import PICTURE_SUFFIXES
from verify.io.encoding import write_video
from verify.io.session.folder import copy_robot
from verify.io.video import picture_name
from verify.simulation.session.simulate import SimulatedSession

TEMPLATES = Path(__file__).parents[1] / "templates"


def readme(session: SimulatedSession) -> str:
    """Write the session's README.md: what it shows, what is true, how the pictures came about."""
    scenario = session.scenario
    distance = np.linalg.norm(session.world.led_points(session.t[:, 0]), axis=-1)
    return fill_template(
        "session.md",
        session=session,
        scenario=scenario,
        encoders=scenario.encoders,
        image=scenario.image,
        arm=session.world.arm.name,
        motion=scenario.motion.__struct_config__.tag,
        spans=", ".join(f"{span:.1f}" for span in np.degrees(np.ptp(session.truth, axis=0))),
        distances=f"{distance.min():.2f} to {distance.max():.2f}",
    )


def fill_template(name: str, **facts: object) -> str:
    """Fill in a text of `templates`; a backslash at the end of a line joins it with the next."""
    text = (TEMPLATES / name).read_text(encoding="utf-8").replace("\\\n", "")
    filled = jinja2.Template(text, undefined=jinja2.StrictUndefined, trim_blocks=True)
    return f"{filled.render(facts)}\n"


START_TIME = datetime(2026, 1, 15, 9, 0, tzinfo=UTC)  # any: a fixed one keeps bytes the same


def write_session(
    session: SimulatedSession, folder: Path, done: Callable[[], object] = lambda: None
) -> None:
    """Write every file of the session, pictures included, into an empty folder.

    Raises:
        InputError: the disk refuses, or the video cannot be written.
    """
    write_tables(session, folder)
    recording = session.scenario.recording
    for side, name in enumerate(SIDES):
        pictures = (session.image(side, index) for index in range(len(session)))
        if recording.format == "video":
            write_video(folder / _stream(session, name), pictures, recording.rate_hz, done)
        else:
            write_pngs(folder / _stream(session, name), pictures, done)


def write_tables(session: SimulatedSession, folder: Path) -> None:
    """Write all but the pictures."""
    joints = session.world.arm.dof
    columns = ",".join(f"q{k}_deg" for k in range(1, joints + 1))
    robot = copy_robot(session.scenario.robot, folder)
    (folder / "session.toml").write_bytes(toml.encode(_session_table(session, robot)))
    rig.write(folder / "rig.toml", session.rig)
    fiducials.write_marker(folder / "marker.toml", session.marker)
    _write_frames(session, folder / "frames.csv")
    table = np.column_stack([session.encoder_t, np.degrees(session.encoder_q)])
    write_csv(folder / "encoders.csv", f"t_s,{columns}", table, ["%.6f"] + ["%.6f"] * joints)
    table = np.column_stack([np.arange(len(session)), np.degrees(session.truth)])
    write_csv(folder / "truth.csv", f"frame,{columns}", table, ["%d"] + ["%.9f"] * joints)
    (folder / "README.md").write_text(readme(session), encoding="utf-8", newline="\n")


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
        table["tolerance"] = msgspec.structs.asdict(scenario.tolerance)
    return table


def _stream(session: SimulatedSession, side: str) -> str:
    return f"{side}.mkv" if session.scenario.recording.format == "video" else side


def _write_frames(session: SimulatedSession, path: Path) -> None:
    header, formats = "frame,t_left_s,t_right_s", ["%d", "%.6f", "%.6f"]
    table = np.column_stack([np.arange(len(session)), session.t])
    if session.scenario.rig.bases == "follow":  # else rig.toml's pan_deg serves every pair
        header, formats = f"{header},pan_left_deg,pan_right_deg", [*formats, "%.6f", "%.6f"]
        table = np.column_stack([table, np.degrees(session.pan)])
    write_csv(path, header, table, formats)


def write_csv(path: Path, header: str, table: Array, formats: list[str]) -> None:
    """Write a table (n, columns) below a header, each column by its %-format."""
    np.savetxt(path, table, formats, delimiter=",", header=header, comments="")


def refuse_remains(out: Path, other: str, pictures: int) -> None:
    """Refuse, by an InputError, what would stay in `out` and be read as part of the new files.

    That is a recording of another kind, by its file `other`, and pictures in left/ and right/
    beyond those that are made, so many a side; with 0 the folders are none of the recording's.
    """
    made = {picture_name(index) for index in range(pictures)}
    there = [file for side in SIDES * bool(made) for file in sorted(out.glob(f"{side}/*"))]
    remains = [file for file in there if file.suffix.lower() in PICTURE_SUFFIXES]
    for path in (out / other, *remains):
        if path.name not in made and path.exists():
            expected = "a recording has a folder of its own"
            raise InputError(path, "would stay", expected, "Choose another -o, or delete it.")


def write_pngs(folder: Path, images: Iterable[Image], done: Callable[[], object]) -> None:
    """Make a folder of numbered PNG files; `done` is called after each."""
    folder.mkdir()
    for index, image in enumerate(images):
        (folder / picture_name(index)).write_bytes(cv2.imencode(".png", image)[1].tobytes())
        done()
