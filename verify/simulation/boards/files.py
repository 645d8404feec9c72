"""Write simulated boards as a folder: what `verify calibrate boards` reads, the truth, a README."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from verify.core.records import SIDES
from verify.io import fiducials, rig, toml
from verify.simulation.boards.simulate import SimulatedBoards
from verify.simulation.session.folder import fill_template, write_csv, write_pngs

PAIR_INTERVAL_S = 4.0  # between two pairs: time to hold the board elsewhere


def write(boards: SimulatedBoards, folder: Path, done: Callable[[], object] = lambda: None) -> None:
    """Write every file into an empty folder; InputError: the disk refuses."""
    fiducials.write_board(folder / "board.toml", boards.board)
    rig.write(folder / "rig_true.toml", boards.rig)
    _write_frames(boards, folder / "frames.csv")
    _write_poses(boards, folder / "board_poses.csv")
    _write_fixture(boards, folder / "board_in_base.toml")
    (folder / "README.md").write_text(_readme(boards), encoding="utf-8", newline="\n")
    for side, name in enumerate(SIDES):
        pictures = (boards.image(side, index) for index in range(len(boards)))
        write_pngs(folder / name, pictures, done)


def _write_frames(boards: SimulatedBoards, path: Path) -> None:
    frame = np.arange(len(boards))
    t = PAIR_INTERVAL_S * frame
    header = "frame,t_left_s,t_right_s,pan_left_deg,pan_right_deg"
    table = np.column_stack([frame, t, t, np.degrees(boards.pan)])
    write_csv(path, header, table, ["%d"] + ["%.6f"] * 4)


def _write_poses(boards: SimulatedBoards, path: Path) -> None:
    turns = [cv2.Rodrigues(rig_T_board[:3, :3])[0].ravel() for rig_T_board in boards.rig_T_board]
    position = 1000 * boards.rig_T_board[:, :3, 3]
    table = np.column_stack([np.arange(len(boards)), turns, position])
    header = "frame,rx_rad,ry_rad,rz_rad,x_mm,y_mm,z_mm"
    write_csv(path, header, table, ["%d"] + ["%.9f"] * 3 + ["%.6f"] * 3)


def _write_fixture(boards: SimulatedBoards, path: Path) -> None:
    """Write where a board that stands on the robot's base was put; exact."""
    fixture = boards.scenario.fixture
    if fixture is not None:
        table = {
            "format": toml.FORMAT,
            "position_mm": list(fixture.board_position_mm),
            "rotation_vector_deg": list(fixture.board_rotation_deg),
        }
        path.write_bytes(toml.encode(table))


def _readme(boards: SimulatedBoards) -> str:
    """Describe what the folder shows, what is true and how the pictures came about."""
    scenario = boards.scenario
    pans = np.degrees(boards.pan)
    turned = "stand still"
    if np.ptp(pans, axis=0).any():
        spans = [
            f"{low:g} to {high:g} deg" for low, high in zip(pans.min(0), pans.max(0), strict=True)
        ]
        turned = f"are turned from pair to pair: left {spans[0]}, right {spans[1]}"
    return fill_template(
        "boards.md", boards=boards, scenario=scenario, image=scenario.image, turned=turned
    )
