"""Write a Rerun recording (.rrd): flange poses, joint angles and the cameras' pictures.

`rerun-sdk` is an extra: it is large, and nothing else needs it. Pictures are PNGs, or JPEGs where
the session has them. Times count from the session's start where it has no date.

Source: Rerun SDK reference (RecordingStream, send_columns).
"""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from verify.core.records import Progress
from verify.errors import InputError, one_line
from verify.io.export.content import UNDATED, ExportContent
from verify.io.files import is_unicode
from verify.io.session.session import Session
from verify.io.video import Images, Video

TIMELINE = "time"
INSTALL = "pip install 'verify-robot[rerun]'"


def load_rerun() -> ModuleType:
    """Import the SDK; raises InputError: it is not installed."""
    os.environ.setdefault("RUST_LOG", "off")  # one line of error is ours
    try:
        import rerun
    except ImportError as error:
        expected = "Rerun's own package writes its files"
        found = "rerun-sdk is not installed"
        raise InputError("--to rrd", found, expected, f"{INSTALL}.") from error
    module: ModuleType = rerun
    return module


def write_rrd(content: ExportContent, path: Path, progress: Progress) -> None:
    """Write a recording; one picture of each camera is in memory.

    Raises:
        InputError: rerun-sdk is not installed, it takes no such path, or a picture cannot be
            decoded.
        OSError: it cannot be written.
    """
    rr = load_rerun()
    if not is_unicode(str(path)):
        expected = "Rerun's package takes UTF-8 alone"
        raise InputError("-o", f"{path.parent} is not UTF-8", expected, "Choose another folder.")
    # the same content has the same identity
    recording: Any = rr.RecordingStream("verify", recording_id=one_line(content.name))
    recording.save(str(path))
    start = content.started.timestamp() if content.started != UNDATED else None
    try:
        for name, poses in content.poses.items():
            columns = rr.Transform3D.columns(
                translation=poses.position.astype(np.float32),
                quaternion=poses.quaternion.astype(np.float32),
            )
            index = rr.TimeColumn(TIMELINE, **_moments(poses.t, start))
            rr.send_columns(f"flange/{name}", [index], columns, recording=recording)
        for name, joints in content.joints.items():
            index = rr.TimeColumn(TIMELINE, **_moments(joints.t, start))
            for joint, q in zip(content.joint_names, np.rad2deg(joints.q).T, strict=True):
                scalars = rr.Scalars.columns(scalars=q)
                rr.send_columns(f"joints_deg/{name}/{joint}", [index], scalars, recording=recording)
        if content.session is not None:
            _log_pictures(rr, recording, content.session, start, progress)
        recording.flush()
        recording.disconnect()  # it writes the end
    except RuntimeError as error:  # the library writes in a thread, and says why on a log alone
        raise OSError("rerun-sdk could not write it; the disk may be full") from error
    finally:
        with suppress(RuntimeError):  # after an error; else it is done already
            recording.disconnect()


def _moments(t: Any, start: float | None) -> dict[str, Any]:
    """Instants t, s, from a start as Rerun names them."""
    return {"duration": t} if start is None else {"timestamp": start + t}


def _log_pictures(
    rr: ModuleType, recording: Any, session: Session, start: float | None, progress: Progress
) -> None:
    frames, done = session.frames, 0
    sides = (("left", session.left, frames.t_left), ("right", session.right, frames.t_right))
    for name, images, times in sides:
        for t, (data, kind) in zip(times.tolist(), _encoded(images), strict=False):
            recording.set_time(TIMELINE, **_moments(t, start))
            recording.log(f"cameras/{name}", rr.EncodedImage(contents=data, media_type=kind))
            done += 1
            progress(done, 2 * len(session))


def _encoded(images: Images) -> Iterator[tuple[bytes, str]]:
    """Pictures as files in memory, each with its media type."""
    if images.lossy and isinstance(images, Video):
        yield from ((data, "image/jpeg") for data in images.packets())
        return
    for image in images.images():
        yield cv2.imencode(".png", image)[1].tobytes(), "image/png"
