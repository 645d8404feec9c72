"""The repeated poses and paths of a session as it is judged, worded for its results."""

from typing import Any

import pandas as pd

from verify.judgement.model import Model
from verify.performance.conditions import deviations
from verify.performance.session import Performance, performance
from verify.performance.words import performance_summary, performance_tables
from verify.readings import Readings
from verify.session import Session
from verify.session_file import stretches


def performed(
    session: Session, model: Model, offset: float
) -> tuple[dict[str, Any], dict[str, pd.DataFrame]]:
    """Find and judge what a session repeats.

    Args:
        session: names poses and paths, or leaves them to be recognised.
        model: what was compared in it.
        offset: s, added to the readings' time to get the cameras' clock.

    Returns:
        `performance` (null where nothing is repeated) and `performance_reason` (why, else null) of
        summary.json; and the tables.
    """
    file = session.folder / "session.toml"
    poses, paths = stretches(file) if file.exists() else ((), ())  # a simulated one has no folder
    instrument = session.instrument
    found = performance(
        model,
        session.arm,
        Readings(session.encoders.t, session.encoders.q),
        offset,
        named_poses=poses,
        named_paths=paths,
        point=(
            instrument.flange_T_body[:3, 3]
            if instrument is not None and instrument.positions_alone
            else None
        ),
    )
    if not isinstance(found, Performance):
        return {"performance": None, "performance_reason": found}, performance_tables(None)
    listed = deviations(
        found, temperature_c=session.temperature_c, through_encoders=model.through_encoders
    )
    entry = performance_summary(found, listed)
    return {"performance": entry, "performance_reason": None}, performance_tables(found)
