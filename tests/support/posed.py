"""Sessions whose poses are read from a file, made from sessions of pictures or from arrays."""

import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from reports import Results
from verify.analysis.session import analyse
from verify.core.records import Array, Measurement, StereoPair
from verify.io.session.session import Session, open_session
from verify.measurement.chain import Setup, measure

HEADER = "t_s,x_mm,y_mm,z_mm"
QUATERNION = "qw,qx,qy,qz"


@dataclass
class Watched:
    """A session measured through its pictures, and each pair's pose in the rig."""

    session: Session
    measurements: list[Measurement] = field(default_factory=list)

    def analyse(self) -> Results:
        """Measure and judge."""
        return analyse(self.session, chain=self._chain)

    def _chain(self, pairs: Iterable[StereoPair], setup: Setup) -> Iterator[Measurement]:
        for measurement in measure(pairs, setup):
            self.measurements.append(measurement)
            yield measurement

    @property
    def poses(self) -> tuple[Array, Array]:
        """Instants (n,), s, and rig_T_flange (n, 4, 4) of the measured pairs."""
        if not self.measurements:
            self.analyse()
        seen = [m for m in self.measurements if m.status == "measured" and m.pose is not None]
        return (
            np.array([m.t for m in seen]),
            np.array([m.pose.rig_T_flange for m in seen if m.pose is not None]),
        )


def poses_csv(
    t: Array, poses: Array, *, positions_alone: bool = False, more: dict[str, Array] | None = None
) -> str:
    """Write (n, 4, 4) poses, m, as the text of a poses.csv; every other quaternion is negated."""
    quaternion = np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, axis=1)
    quaternion[::2] *= -1
    columns = [f"{v:.6f}" for v in t], *([f"{v:.6f}" for v in c] for c in poses[:, :3, 3].T * 1e3)
    header = HEADER
    if not positions_alone:
        columns = (*columns, *([f"{v:.9f}" for v in c] for c in quaternion.T))
        header += f",{QUATERNION}"
    for name, values in (more or {}).items():
        columns = (*columns, [f"{v:.6f}" for v in values])
        header += f",{name}"
    return "\n".join([header, *(",".join(row) for row in zip(*columns, strict=True)), ""])


def encoders_csv(t: Array, q: Array) -> str:
    """Write readings (n, 6), rad, as the text of an encoders.csv."""
    rows = [
        f"{a:.4f}," + ",".join(f"{v:.9f}" for v in row)
        for a, row in zip(t, np.rad2deg(q), strict=True)
    ]
    return "\n".join(["t_s," + ",".join(f"q{j}_deg" for j in range(1, 7)), *rows, ""])


def write_posed(
    folder: Path, like: Path, poses: str, *, frame: str = "rig", more: str = "", encoders: str = ""
) -> Path:
    """Write a session of poses with the robot, rig and readings of a session of pictures.

    Args:
        folder: to make.
        like: the session of pictures.
        poses: the text of poses.csv.
        frame: that they are in.
        more: further lines of session.toml, first those of [poses].
        encoders: the text of encoders.csv, if not that of the session of pictures.
    """
    folder.mkdir()
    (folder / "encoders.csv").write_text(encoders or (like / "encoders.csv").read_text())
    rig = ""
    if frame == "rig":
        shutil.copy(like / "rig.toml", folder)
        rig = 'rig = "rig.toml"\n'
    (folder / "poses.csv").write_text(poses)
    (folder / "session.toml").write_text(
        f'format = 1\nrobot = "{open_session(like).robot}"\nencoders = "encoders.csv"\n{rig}\n'
        f'[poses]\nfile = "poses.csv"\ninstrument = "a laser tracker"\nframe = "{frame}"\n{more}'
    )
    return folder
