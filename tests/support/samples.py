"""Remake sample_sessions/ from the built-in scenarios of the same names: `make samples`."""

import shutil
from pathlib import Path

from verify.io.files import write_folder_whole
from verify.simulation import library
from verify.simulation.session.folder import write_session
from verify.simulation.session.simulate import simulate_session

FOLDER = Path(__file__).parents[2] / "sample_sessions"
SAMPLES = ("quarter_circle_6r", "multi_joint_fault_6r", "multi_joint_rv_3sd")


def remake() -> None:
    """Write every sample anew; nothing of an old one stays."""
    for name in SAMPLES:
        session = simulate_session(library.load(name))
        shutil.rmtree(FOLDER / name, ignore_errors=True)
        with write_folder_whole(FOLDER / name) as folder:
            write_session(session, folder)
        print(f"{name}: {len(session)} pairs")


if __name__ == "__main__":
    remake()
