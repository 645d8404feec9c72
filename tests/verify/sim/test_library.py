from pathlib import Path

import msgspec
import pytest

from tests.verify.sim.scenes import scene
from verify.errors import InputError
from verify.sim import library
from verify.sim.scenario import (
    Fault,
    MultiJoint,
    Occlusion,
    Recording,
    RigTable,
    Scenario,
    Table,
)
from verify.sim.sessions import simulate

MINIMAL = """
format = 1
robot = "iust_6r"
seed = 1
[motion]
kind = "multi_joint"
home_deg = [30.0, -62.0, 46.0, 8.0, -84.0, 24.0]
amplitude_deg = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0]
[recording]
pairs = 3
rate_hz = 10.0
[[marker.led]]
name = "A"
position_mm = [60.0, 5.0, 20.0]
"""


@pytest.mark.parametrize("name", library.names())
def test_every_built_in_scenario_plays(name: str) -> None:
    session = simulate(library.load(name))
    assert len(session) > 0


def test_a_minimal_scenario_is_enough(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(MINIMAL)
    assert len(simulate(library.load(str(path)))) == 3


def test_the_example_shows_every_key() -> None:
    text = (Path(library.__file__).parent / "scenarios" / "example.toml").read_text()
    for table in (Scenario, *Table.__subclasses__()):
        for field in msgspec.structs.fields(table):
            assert field.encode_name in text, f"{table.__name__}.{field.encode_name}"


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("seed = 1", "sed = 1", ["sed", "seed"]),
        ("rate_hz = 10.0", "rate = 10.0", ["recording", "rate", "rate_hz"]),
        ("rate_hz = 10.0", "rate_hz = -1.0", ["recording.rate_hz", "> 0"]),
        ("rate_hz = 10.0", 'rate_hz = "fast"', ["recording.rate_hz", "float"]),
        ("rate_hz = 10.0", "rate_hz = inf", ["recording.rate_hz", "finite"]),
        ("pairs = 3", "pairs = 0", ["recording.pairs", ">= 1"]),
        ('kind = "multi_joint"', 'kind = "dance"', ["motion", "dance"]),
        ("amplitude_deg = [5.0, 5.0, 5.0, 5.0, 5.0, 5.0]", "", ["amplitude_deg"]),
        ("format = 1", "format = 2", ["format", "2"]),
        ("[recording]", "[recording", ["TOML"]),
    ],
)
def test_a_bad_scenario_is_refused_with_the_key_at_fault(
    line: str, instead: str, words: list[str]
) -> None:
    with pytest.raises(InputError) as refused:
        library.decode(MINIMAL.replace(line, instead), "mine.toml")
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
        ({"fault": [Fault(joint=7)]}, r"fault\[0\].joint"),
        ({"occlusion": [Occlusion(led="Z", first=0, last=1)]}, r"occlusion\[0\].led"),
        ({"recording": Recording(pairs=2, rate_hz=5.0, dropped=[0, 1])}, "no pair is left"),
        ({"recording": Recording(pairs=9, rate_hz=90.0, skew_jitter_s=1.0)}, "skew_jitter_s"),
        ({"motion": MultiJoint(home_deg=[170.0] * 6, amplitude_deg=[30.0] * 6)}, "limits"),
        ({"rig": RigTable(distance_mm=60.0)}, "no place near"),
    ],
)
def test_a_scenario_that_contradicts_itself_is_refused(
    changes: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        simulate(scene(**changes))
