"""Readings of another motion are refused, with the mistake that explains them; faults are not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from verify.analysis.clock.estimate import estimate_clock
from verify.analysis.measured import measure_pictures
from verify.analysis.mistakes import refuse_other_motion
from verify.core.readings import Readings
from verify.core.records import Array
from verify.errors import InputError
from verify.io.session.session import Session, open_session
from verify.measurement.chain import measure
from verify.measurement.track import Track

SAMPLE = Path(__file__).parents[3] / "sample_sessions" / "multi_joint_fault_6r"


@pytest.fixture(scope="module")
def recording() -> tuple[Session, Track]:
    session = replace(open_session(SAMPLE), clock=None)
    return session, measure_pictures(session, lambda _done, _total: None, measure).track


def judge(recording: tuple[Session, Track], q: Array) -> None:
    session, track = recording
    readings = Readings(session.encoders.t, q)
    refuse_other_motion(session, track, readings, estimate_clock(track, session.arm, readings))


def reverse_first(q: Array) -> Array:
    return q * [-1, 1, 1, 1, 1, 1]


def freeze(q: Array) -> Array:
    return np.tile(q[0], (len(q), 1))


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (reverse_first, r"encoders\.csv: .*joint 1 reversed fits.* column q1_deg by -1"),
        pytest.param(freeze, "readings never change", marks=pytest.mark.slow),
    ],
)
def test_a_mistake_is_named(
    recording: tuple[Session, Track], mistake: Callable[[Array], Array], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        judge(recording, mistake(recording[0].encoders.q))


def test_a_base_written_the_wrong_way_round_is_named(recording: tuple[Session, Track]) -> None:
    session, track = recording
    base_T_rig = np.asarray(np.linalg.inv(session.rig.rig_T_base), dtype=np.float64)
    wrong = replace(session, rig=replace(session.rig, rig_T_base=base_T_rig))
    moved = replace(
        track, base_T_flange=session.rig.rig_T_base @ session.rig.rig_T_base @ track.base_T_flange
    )
    with pytest.raises(InputError, match=r"rig\.toml: .*base inverted fits"):
        judge((wrong, moved), session.encoders.q)


@pytest.mark.parametrize(
    "size_deg", [4.0, pytest.param(40.0, marks=pytest.mark.slow)], ids=["small", "large"]
)
def test_an_offset_and_a_slipped_belt_are_faults(
    recording: tuple[Session, Track], size_deg: float
) -> None:
    session, _ = recording
    for since in (0.0, float(np.median(session.encoders.t))):
        q = session.encoders.q.copy()
        q[session.encoders.t >= since, 2] += np.deg2rad(size_deg)
        judge(recording, q)
