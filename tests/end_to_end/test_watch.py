"""`verify run STATION` as a user runs it: faults of every device, the disk, the clock; no fault is
said as a number, and each is said in words."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.bench.kills import MOST, kill
from tests.support.command import SAMPLES, verify
from tests.support.devices.emulated_station import emulator, start_beside
from tests.support.rounding import ROUNDING_DEG
from tests.support.small_disk import mounted
from tests.support.watched import Run, listen
from verify.cli.measure import measure_and_report_all
from verify.cli.options import ToleranceOptions
from verify.errors import InputError
from verify.io.session.session import open_session
from verify.live.station.file import template
from verify.simulation.emulators.server import EmulatorFaults

SLOW = "rate_hz = 10.0"  # pictures a second: a machine that does other things keeps up


def station(folder: Path, text: str = "", **replaced: str) -> Path:
    """The template, slower, with more at its end and some lines replaced."""
    written = template().replace("rate_hz = 30.0", SLOW)
    for old, new in replaced.items():
        key = f"{old} = "
        line = next(x for x in written.splitlines() if x.startswith(key))
        written = written.replace(line, f"{key}{new}", 1)
    path = folder / "station.toml"
    path.write_text(written + text)
    return path


def started(path: Path, *words: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "verify", "run", str(path), "--json", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=path.parent)


def event(what: str, at: float, lasts: float | None = None, **more: object) -> str:
    keys = {"what": what, "at_s": at, "for_s": lasts, **more}
    lines = [f"{k} = {json.dumps(v)}" for k, v in keys.items() if v is not None]
    return "\n[[sim.event]]\n" + "\n".join(lines) + "\n"


@pytest.mark.realtime
def test_camera_faults_are_reported_and_the_jumping_joint_is_named(tmp_path: Path) -> None:
    events = (
        event("camera_gone", 4.0, 2.0, camera="left")
        + event("camera_stalls", 8.0, 2.0, camera="right")
        + event("leds_covered", 12.0, 2.0)
        + event("lamp_on", 16.0, 2.0)
        + event("encoder_jump", 21.0, joint=4, degrees=0.5)
    )
    run = listen(started(station(tmp_path, events), "--for", "25s", "-o", "out"), Run())
    devices = [a["device"] for a in run.told("device")]
    assert devices == ["left camera", "right camera"]
    assert [a["device"] for a in run.told("device", over=True)] == devices
    lost = run.told("target")
    assert len(lost) == len(run.told("target", over=True)) == 3
    assert any("too few LEDs" in a["text"] for a in lost)
    assert run.worst(joint=4) < 6.0
    jumped = [a for a in run.told("change") if a["joint"] == 4]
    assert len(jumped) == 1
    assert jumped[0]["error_deg"] == pytest.approx(0.5, abs=0.1)
    sizes = [(p["t_s"], p["error_deg"][3]) for p in run.pairs if p["error_deg"][3] is not None]
    before = max(t for t, size in sizes if size < 0.25)
    assert jumped[0]["t_s"] - before < 1.0
    assert run.told("change") == jumped
    assert run.result["summary"]["pairs"]["measured"] > 100
    assert (tmp_path / "out" / "report.pdf").exists()
    kept = pd.read_csv(tmp_path / "out" / "alarms.csv")
    (folder,) = (tmp_path / "recordings").iterdir()
    assert (folder / "alarms.csv").read_bytes() == (tmp_path / "out" / "alarms.csv").read_bytes()
    assert list(kept["device"].dropna()) == devices
    assert kept["joint"].dropna().tolist() == [4]
    assert kept["began_utc"].is_monotonic_increasing
    statuses = {"conform": 0, "nonconform": 1, "undecided": 3}
    assert run.status == statuses[run.result["summary"]["verdict"]]


@pytest.mark.realtime
def test_live_figures_are_those_of_the_recording(tmp_path: Path) -> None:
    run = listen(started(station(tmp_path), "--for", "8s", "-o", "out"), Run())
    again = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert again["pairs"]["recorded"] == len(run.pairs)
    (folder,) = (tmp_path / "recordings").iterdir()
    session = open_session(folder)
    assert len(session) == len(run.pairs)
    frames = pd.read_parquet(tmp_path / "out" / "results" / "frames.parquet")
    live = {p["frame"]: p["measured_deg"] for p in run.settled if p["status"] == "measured"}
    names = [f"q{j}_measured_deg" for j in range(1, 7)]
    recorded = frames.set_index("frame")[names]
    assert len(live) > 50
    for frame, angles in live.items():
        np.testing.assert_allclose(
            recorded.loc[frame].to_numpy(), angles, rtol=0, atol=ROUNDING_DEG
        )


@pytest.mark.realtime
def test_a_disturbed_line_and_clock_jumps_give_no_false_reading(tmp_path: Path) -> None:
    faults = EmulatorFaults(
        noise=0.02, half=0.02, digit=0.02, double=0.02, lost=0.02, split=0.02,
        silence=(6.0, 2.0), jump=(11.0, 3.0), reset=(16.0, 16.0),
    )  # fmt: skip
    began = time.monotonic()
    with emulator("labenc", "pty", began, faults) as (address, go):
        path = station(tmp_path, driver=f'"labenc"\nport = "{address}"')
        process = start_beside(path, began, 90.0)
        run = Run()
        listen(process, run, lambda pair: pair["frame"] == 5)
        go()
        end = time.monotonic() + 22.0
        listen(process, run, lambda _: time.monotonic() > end)
        process.send_signal(signal.SIGINT)
        listen(process, run)
    assert "encoders" in [a["device"] for a in run.told("device")]
    assert "no_encoder" in {p["status"] for p in run.pairs}
    assert run.worst() < 6.0
    assert not run.told("change")
    segments = [p["clock"]["segment"] for p in run.pairs if p["clock"] is not None]
    assert segments == sorted(segments)
    assert segments[-1] == 2
    assert "stopped" not in run.watched["recording"]
    folders = sorted((tmp_path / "recordings").iterdir())
    assert len(folders) == 3
    assert sum(len(open_session(folder)) for folder in folders) == len(run.pairs)
    assert len([p for p in run.pairs if p["status"] == "measured"]) > 100
    again = verify("run", folders[0], "-o", tmp_path / "again")  # its line fell silent for 2 s
    assert again.status in {0, 1, 3}
    frames = pd.read_parquet(tmp_path / "again" / "results" / "frames.parquet")
    for joint in range(1, 7):
        doubt = frames[f"q{joint}_error_u_deg"].clip(lower=0.02)
        assert (frames[f"q{joint}_error_deg"].abs() / doubt).max() < 6.0
    assert {"measured", "no_encoder"} == set(frames["status"])


@pytest.mark.realtime
def test_bases_follow_and_a_lost_base_is_reported(tmp_path: Path) -> None:
    scenario = tmp_path / "wide.toml"
    scenario.write_text(WIDE)
    events = event("pan_gone", 14.0, 3.0)
    path = station(tmp_path, events, scenario='"wide.toml"')
    fixed = '[pan]\ndriver = "fixed"'
    assert fixed in path.read_text()
    path.write_text(path.read_text().replace(fixed, '[pan]\ndriver = "sim"\nfollow = true'))
    run = listen(started(path, "--for", "20s", "-o", "out"), Run())
    assert [a["device"] for a in run.told("device")] == ["pan bases"], run.told("device")
    dropped = run.watched["dropped"]
    assert any("base" in why for why in dropped)
    (folder,) = (tmp_path / "recordings").iterdir()
    frames = open_session(folder).frames
    assert np.ptp(np.rad2deg(frames.pan_left)) > 3.0  # they turned
    assert run.worst() < 6.0
    measured = [p for p in run.pairs if p["status"] == "measured"]
    assert len(measured) > 0.9 * len(run.pairs)


@pytest.mark.realtime
def test_a_disk_that_fills_up_ends_the_recording_and_nothing_else(tmp_path: Path) -> None:
    with mounted(tmp_path / "recordings", "-o", "size=5m") as disk:
        path = station(tmp_path, event("encoder_jump", 9.0, joint=4, degrees=0.5))
        run = listen(started(path, "--for", "12s", "-o", "out"), Run())
        assert "no space left on device" in run.watched["recording"], run.watched
        assert [a["device"] for a in run.told("device")] == ["recording"]
        (folder,) = disk.iterdir()
        kept = len(open_session(folder))
        assert 5 < kept < len(run.pairs)
        assert run.result["summary"]["pairs"]["recorded"] == kept
        missing = run.watched["pairs"] - kept
        assert run.result["summary"]["warnings"][0].startswith(f"{missing} of ")
        assert [a["joint"] for a in run.told("change")] == [4]


@pytest.mark.realtime
@pytest.mark.long
def test_killed_runs_leave_sessions_up_to_their_last_second_and_no_process() -> None:
    for number, after in enumerate((0.0, 0.35, 2.6)):
        killed = kill(after, whole_group=number % 2 == 0)
        assert killed.loss < MOST, killed
        assert killed.status in {0, 1, 3}, killed
        assert not killed.orphans


def test_ctrl_c_ends_the_run_with_a_report(tmp_path: Path) -> None:
    process = started(station(tmp_path), "-o", "out")
    run = listen(process, Run(), lambda pair: pair["frame"] == 30)
    process.send_signal(signal.SIGINT)
    listen(process, run)
    assert run.result["summary"]["pairs"]["measured"] > 25
    assert run.status in {0, 1, 3}
    assert "closed" in run.watched["recording"]


def test_options_of_a_station_are_refused_for_a_recording_and_the_other_way_round(
    tmp_path: Path,
) -> None:
    assert "--for" in verify("run", tmp_path, "--for", "10s").refusal
    assert "none.toml" in verify("run", tmp_path / "none.toml").refusal
    path = tmp_path / "station.toml"
    assert verify("run", "--new-station", path).status == 0
    assert "exists" in verify("run", "--new-station", path).refusal
    for wrong in ("10 parsecs", "-3s", "0"):
        assert "--for" in verify("run", path, "--for", wrong).refusal


WIDE = (
    (Path(__file__).parents[2] / "verify" / "simulation" / "scenarios" / "multi_joint_rv_3sd.toml")
    .read_text()
    .replace("amplitude_deg = [14.0,", "amplitude_deg = [34.0,")
    .replace("slowest_hz = 0.2", "slowest_hz = 0.05")
    .replace("fastest_hz = 0.6", "fastest_hz = 0.15")
    .replace("pairs = 60", "pairs = 300")
    .replace("distance_mm = 650.0", 'distance_mm = 650.0\nbases = "follow"')
)


@pytest.mark.realtime
def test_a_watch_without_any_reading_says_so_and_why(tmp_path: Path) -> None:
    path = station(tmp_path, event("encoder_silent", 0.0))
    refusal = verify("run", path, "--for", "1s", "-o", tmp_path / "out").refusal
    assert "pairs and no reading (encoders: simulated encoders: silent)" in refusal
    assert not (tmp_path / "out").exists()


@pytest.mark.realtime
def test_an_unmeasurable_part_does_not_affect_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = SAMPLES / "multi_joint_rv_3sd"
    broken = tmp_path / "broken"
    shutil.copytree(good, broken)
    (broken / "encoders.csv").write_text("t_s,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n")
    asked = ToleranceOptions(None, None, None)
    verdicts = measure_and_report_all([broken, good], tmp_path / "out", asked, force=False)
    assert verdicts == {tmp_path / "out-2": "conform"}
    assert (tmp_path / "out-2" / "report.pdf").exists()
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError, match=r"encoders\.csv"):
        measure_and_report_all(
            [broken], tmp_path / "again", asked, force=False, warnings=("9 pairs are missing.",)
        )
    assert "9 pairs are missing." in capsys.readouterr().err
