"""A disk that fills up midway leaves nothing half-written behind."""

import errno
from pathlib import Path

import pytest

from verify.calibration.undoing import undone_on_failure
from verify.writing import write_whole


def test_files_stay_where_all_went_well(tmp_path: Path) -> None:
    rig, marker = tmp_path / "rig.toml", tmp_path / "marker.toml"
    with undone_on_failure(rig, marker):
        write_whole(rig, b"new")
    assert rig.read_bytes() == b"new"
    assert not marker.exists()


def written_and_failed(failure: BaseException, rig: Path, marker: Path) -> None:
    with undone_on_failure(rig, marker):
        write_whole(rig, b"new")
        write_whole(marker, b"new")
        raise failure


@pytest.mark.parametrize("failure", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_a_failure_takes_new_files_away_and_brings_old_ones_back(
    tmp_path: Path, failure: BaseException
) -> None:
    rig, marker = tmp_path / "rig.toml", tmp_path / "marker.toml"
    marker.write_bytes(b"old")
    with pytest.raises(type(failure)):
        written_and_failed(failure, rig, marker)
    assert [p.name for p in tmp_path.iterdir()] == ["marker.toml"]
    assert marker.read_bytes() == b"old"
