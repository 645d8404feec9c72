"""Remake sample_sessions/ from the built-in scenarios of the same names: `make samples`."""

import shutil
from pathlib import Path

from verify.sim import library
from verify.sim.folder import write
from verify.sim.sessions import simulate
from verify.writing import folder_written_whole

FOLDER = Path(__file__).parent.parent / "sample_sessions"
SAMPLES = ("quarter_circle_6r", "multi_joint_fault_6r", "multi_joint_rv_3sd")


def remake() -> None:
    """Write every sample anew; nothing of an old one stays."""
    for name in SAMPLES:
        session = simulate(library.load(name))
        shutil.rmtree(FOLDER / name, ignore_errors=True)
        with folder_written_whole(FOLDER / name) as folder:
            write(session, folder)
        print(f"{name}: {len(session)} pairs")


if __name__ == "__main__":
    remake()
