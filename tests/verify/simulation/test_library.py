"""sample_sessions/ is what `make samples` would write today."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.samples import FOLDER, SAMPLES
from tests.support.simulated import MINIMAL, keys_of, played
from verify.errors import InputError
from verify.simulation import library
from verify.simulation.scenario import (
    MultiJoint,
    Occlusion,
    Scenario,
    ScenarioFault,
    ScenarioRecording,
    ScenarioRig,
)
from verify.simulation.session.folder import write_tables
from verify.simulation.session.simulate import simulate_session


@pytest.mark.parametrize("name", library.names())
def test_every_built_in_scenario_plays(name: str) -> None:
    session = simulate_session(library.load(name))
    assert len(session) > 0


def test_the_example_shows_every_key() -> None:
    text = (Path(library.__file__).parent / "scenarios" / "example.toml").read_text()
    assert not [key for key in keys_of(Scenario) if key.partition(".")[2] not in text]


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("seed = 1", "sed = 1", ["sed", "seed"]),
        ("rate_hz = 10.0", "rate_hz = -1.0", ["recording.rate_hz", "above 0"]),
        ('kind = "multi_joint"', 'kind = "dance"', ["motion", "dance"]),
        ("amplitude_deg = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0]", "", ["amplitude_deg"]),
    ],
)
def test_a_bad_scenario_is_refused_with_the_key_at_fault(
    line: str, instead: str, words: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MINIMAL.replace(line, instead))
    with pytest.raises(InputError) as refused:
        library.load(str(path))
    for word in ["mine.toml", *words]:
        assert word in str(refused.value)


def test_an_unknown_name_is_refused_with_a_suggestion_and_the_list() -> None:
    with pytest.raises(InputError, match='did you mean "quarter_circle_6r"') as refused:
        library.load("quarter_circle")
    assert "multi_joint_rv_3sd" in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motion": MultiJoint(home_deg=[0.0] * 5, amplitude_deg=[1.0] * 6)}, "motion.home_deg"),
        ({"fault": [ScenarioFault(joint=7)]}, r"fault\[0\].joint"),
        ({"occlusion": [Occlusion(led="Z", first=0, last=1)]}, r"occlusion\[0\].led"),
        ({"recording": ScenarioRecording(pairs=2, rate_hz=5.0, dropped=[0, 1])}, "no pair is left"),
        (
            {"recording": ScenarioRecording(pairs=9, rate_hz=90.0, skew_jitter_s=1.0)},
            "skew_jitter_s",
        ),
        ({"motion": MultiJoint(home_deg=[170.0] * 6, amplitude_deg=[30.0] * 6)}, "limits"),
        ({"rig": ScenarioRig(distance_mm=60.0)}, "no place near"),
    ],
)
def test_a_scenario_that_contradicts_itself_is_refused(
    changes: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        played(**changes)


NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
REMEDY = "the samples are stale: run `make samples`"
LIMIT_MB = 25.0  # a clone should stay light


def numbers(text: str) -> list[float]:
    return [float(n) for n in NUMBER.findall(text)]


@pytest.mark.parametrize("name", SAMPLES)
def test_a_samples_tables_are_what_its_scenario_gives(name: str, tmp_path: Path) -> None:
    write_tables(simulate_session(library.load(name)), tmp_path)
    for fresh in tmp_path.iterdir():
        kept = (FOLDER / name / fresh.name).read_text(encoding="utf-8")
        made = fresh.read_text(encoding="utf-8")
        assert NUMBER.sub("#", kept) == NUMBER.sub("#", made), f"{fresh.name}: {REMEDY}"
        # 2e-6: one unit of the last written digit, which processors may round differently
        assert np.allclose(numbers(kept), numbers(made), rtol=0, atol=2e-6), REMEDY


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
def test_a_samples_pictures_are_what_its_scenario_renders(name: str) -> None:
    session = simulate_session(library.load(name))
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
