import csv
import tomllib
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import robots
from tests.support.simulated import played, scene
from verify.core.records import Image
from verify.io.session.session import open_session
from verify.simulation.scenario import (
    ScenarioClock,
    ScenarioEncoders,
    ScenarioImage,
    ScenarioRecording,
    ScenarioRig,
    ScenarioTolerance,
    ScenarioUncertainty,
)
from verify.simulation.session.folder import write_session
from verify.simulation.session.simulate import SimulatedSession

RECORDING = ScenarioRecording(pairs=8, rate_hz=10.0, skew_s=0.003, dropped=[2, 5])


def rich_session() -> SimulatedSession:
    return played(
        recording=RECORDING,
        rig=ScenarioRig(bases="follow"),
        encoders=ScenarioEncoders(resolution_deg=0.01, clock_offset_s=0.05),
        clock=ScenarioClock(encoder_offset_standard_uncertainty_s=0.001),
        tolerance=ScenarioTolerance(joints_deg=0.2, position_mm=1.0),
        uncertainty=ScenarioUncertainty(
            focal_px=0.2, base_rotation_deg=0.02, led_body_mm=0.05, led_mm=0.05, pan_deg=0.01
        ),
    )


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def decoded(path: Path) -> list[Image]:
    video = cv2.VideoCapture(str(path))
    images = []
    while (read := video.read())[0]:
        images.append(np.asarray(read[1], dtype=np.uint8))
    return images


def test_a_folder_holds_the_sessions_own_numbers_and_reads_back(tmp_path: Path) -> None:
    session = rich_session()
    write_session(session, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {
        *("session.toml", "rig.toml", "marker.toml", "frames.csv", "encoders.csv"),
        *("truth.csv", "left.mkv", "right.mkv", "README.md"),
    }
    table = tomllib.loads((tmp_path / "session.toml").read_text())
    assert table["clock"]["encoder_offset_s"] == pytest.approx(0.05, abs=0.005)
    assert table["tolerance"] == {"joints_deg": 0.2, "position_mm": 1.0}
    opened = open_session(tmp_path)
    assert opened.warnings == ()
    assert opened.clock.standard_uncertainty == 0.001
    assert opened.encoder_resolution == pytest.approx(np.radians(0.01))
    times = np.stack([opened.frames.t_left, opened.frames.t_right], axis=1)
    assert_allclose(times, session.t, atol=1e-9)
    assert_allclose(times[:, 0], 1.0 + np.array([0, 1, 3, 4, 6, 7]) / 10)  # 2 and 5 were dropped
    pans = np.stack([opened.frames.pan_left, opened.frames.pan_right], axis=1)
    assert_allclose(pans, session.pan, atol=2e-8)
    assert_allclose(opened.encoders.q, session.encoder_q, atol=2e-8)
    truth = rows(tmp_path / "truth.csv")
    assert [int(r["frame"]) for r in truth] == list(range(6))
    q = np.array([[float(r[f"q{k}_deg"]) for k in range(1, 7)] for r in truth])
    assert_allclose(q, np.degrees(session.world.joints(times[:, 0])), atol=1e-6)
    assert_allclose(opened.rig.left.matrix, session.rig.left.matrix)
    assert_allclose(opened.rig.left.pan_center, [-0.085, 0.0, 0.0])
    assert opened.rig.left.pan_standard_uncertainty == pytest.approx(np.radians(0.01))
    assert_allclose(opened.rig.rig_T_base, session.rig.rig_T_base, atol=1e-12)
    assert opened.rig.covariance.parameters[0] == "left.fx_px"
    assert len(opened.rig.covariance.parameters) == 7
    assert opened.marker.names == ("A", "B", "C")
    assert_allclose(opened.marker.leds, session.marker.leds, atol=1e-15)
    assert_allclose(opened.marker.leds[0], [0.06, 0.005, 0.02])
    assert opened.marker.led_diameter == pytest.approx(0.005)
    assert opened.marker.led_standard_uncertainty == pytest.approx(5e-5)
    assert opened.marker.body_standard_uncertainty[0] == pytest.approx(5e-5)


@pytest.mark.parametrize("colour", [False, True])
def test_the_video_is_lossless(tmp_path: Path, colour: bool) -> None:
    image = ScenarioImage(colour=colour, background_dn=30.0, black_level_dn=5.0)
    session = played(recording=ScenarioRecording(pairs=2, rate_hz=5.0), image=image)
    write_session(session, tmp_path)
    for side, name in enumerate(("left.mkv", "right.mkv")):
        images = decoded(tmp_path / name)
        assert len(images) == 2
        for index, seen in enumerate(images):
            rendered = session.image(side, index)
            assert_array_equal(seen if colour else seen[..., 0], rendered)


def test_pictures_can_be_numbered_png_files(tmp_path: Path) -> None:
    recording = msgspec.structs.replace(RECORDING, format="png")
    session = played(recording=recording)
    write_session(session, tmp_path)
    assert tomllib.loads((tmp_path / "session.toml").read_text())["left"] == "left"
    names = sorted(p.name for p in (tmp_path / "left").iterdir())
    assert names == [f"{i:06d}.png" for i in range(6)]
    seen = cv2.imread(str(tmp_path / "left" / "000004.png"), cv2.IMREAD_UNCHANGED)
    assert_array_equal(seen, session.image(0, 4))


def test_the_same_scenario_writes_the_same_bytes_and_another_seed_other_ones(
    tmp_path: Path,
) -> None:
    recording = ScenarioRecording(pairs=2, rate_hz=5.0)
    for name, seed in (("one", 1), ("again", 1), ("other", 2)):
        (tmp_path / name).mkdir()
        write_session(played(recording=recording, seed=seed), tmp_path / name)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name
    for name in ("left.mkv", "encoders.csv", "truth.csv"):
        one, other = (tmp_path / folder / name for folder in ("one", "other"))
        assert one.read_bytes() != other.read_bytes()


def test_a_robots_own_file_travels_with_the_session(tmp_path: Path) -> None:
    known = Path(robots.__file__).parent / "iust_6r.toml"
    (tmp_path / "rig.toml").write_bytes(known.read_bytes())  # an awkward name on purpose
    session = played(
        robot=str(tmp_path / "rig.toml"), recording=ScenarioRecording(pairs=1, rate_hz=5.0)
    )
    out = tmp_path / "out"
    out.mkdir()
    write_session(session, out)
    opened = open_session(out)
    assert opened.arm.name == "iust_6r"
    assert_array_equal(opened.arm.upper, session.world.arm.upper)


def test_visits_far_apart_log_encoders_around_each_visit_only(tmp_path: Path) -> None:
    from verify.simulation.scenario import Visits

    table = Visits(home_deg=scene().motion.home_deg, amplitude_deg=[8.0] * 6)
    session = played(motion=table, recording=ScenarioRecording(pairs=5, rate_hz=0.02))
    assert np.all(np.diff(session.t[:, 0]) == pytest.approx(50.0))
    distance = np.abs(session.encoder_t[:, None] - session.t[:, 0]).min(axis=1)
    assert distance.max() <= 0.61
    assert len(session.encoder_t) == pytest.approx(5 * 61, abs=5)
    write_session(session, tmp_path)
    assert len(rows(tmp_path / "frames.csv")) == 5
