"""sample_sessions/ is what `make samples` would write today."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.samples import FOLDER, SAMPLES
from verify.sim import library
from verify.sim.folder import write_tables
from verify.sim.sessions import simulate

NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
REMEDY = "the samples are stale: run `make samples`"
LIMIT_MB = 25.0  # a clone should stay light


def numbers(text: str) -> list[float]:
    return [float(n) for n in NUMBER.findall(text)]


@pytest.mark.parametrize("name", SAMPLES)
def test_a_samples_tables_are_what_its_scenario_gives(name: str, tmp_path: Path) -> None:
    write_tables(simulate(library.load(name)), tmp_path)
    for fresh in tmp_path.iterdir():
        kept = (FOLDER / name / fresh.name).read_text(encoding="utf-8")
        made = fresh.read_text(encoding="utf-8")
        assert NUMBER.sub("#", kept) == NUMBER.sub("#", made), f"{fresh.name}: {REMEDY}"
        # 2e-6: one unit of the last written digit, which processors may round differently
        assert np.allclose(numbers(kept), numbers(made), rtol=0, atol=2e-6), REMEDY


@pytest.mark.parametrize("name", SAMPLES)
def test_a_samples_pictures_are_what_its_scenario_renders(name: str) -> None:
    session = simulate(library.load(name))
    for side, file in enumerate(("left.mkv", "right.mkv")):
        video = cv2.VideoCapture(str(FOLDER / name / file))
        for index in range(len(session)):
            read, image = video.read()
            assert read, REMEDY
            if index in (0, len(session) // 2, len(session) - 1):
                fresh = session.image(side, index)
                differing = np.count_nonzero(image[..., 0] != fresh)
                assert differing <= 20, REMEDY  # a value on the edge of rounding, here and there
        assert not video.read()[0], REMEDY


def test_the_samples_are_small() -> None:
    size = sum(f.stat().st_size for f in FOLDER.rglob("*") if f.is_file())
    assert size < LIMIT_MB * 1e6


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_stay_in_view_and_clear_of_singularities(name: str) -> None:
    session = simulate(library.load(name))
    assert np.abs(np.sin(session.truth[:, 4])).min() > 0.3
    for side in range(2):
        spots = session.spots(side)
        assert np.all((spots > 20) & (spots < np.array([1259, 699])))
