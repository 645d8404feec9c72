"""Commands with folders to break: every kind of file, by every command that reads one.

Folders are small, and so is what is done with them: a case takes about a second.
"""

import re
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import robots
from tests.support import planning
from tests.support.bags import bag_of, write_bag
from tests.support.command import ROOT, verify
from tests.support.foxglove import write_mcap
from tests.support.grasp.cells import CELL, STATION
from tests.support.posed import poses_csv, write_posed
from tests.support.simulated import FIXTURE, MINIMAL, SMALL_BOARDS
from tests.support.watched import station_text
from verify.fleet.batch.records import perform
from verify.io.session.session import open_session
from verify.io.unfinished import NAME, UnfinishedPairs
from verify.io.video import open_images

SESSION = """
[[marker.led]]
name = "B"
position_mm = [-50.0, 36.0, 12.0]

[[marker.led]]
name = "C"
position_mm = [-20.0, -55.0, 28.0]

[[marker.led]]
name = "D"
position_mm = [26.0, 52.0, 36.0]

[uncertainty]
draw = false
focal_px = 0.05
principal_point_px = 0.05
camera_rotation_deg = 0.002
base_position_mm = 0.02
base_rotation_deg = 0.005
led_body_mm = 0.01
led_body_deg = 0.005
led_mm = 0.01

[clock]
encoder_offset_standard_uncertainty_s = 0.0005

[tolerance]
joints_deg = 0.2

"""
AMPLITUDES = "15.0, 12.0, 15.0, 20.0, 20.0, 30.0"
NEAR = "--near 30,-62,46,8,-84,24 --within-deg 35 --poses 4 --rate-hz 4 --clock-uncertainty-ms 0.5"
REPORT = "report {in}"
SAME_REPORT = ("run PNGs", "run MJPEG", "run open", "film of boards", "run registered",
               "watch")  # fmt: skip
RUN = "run {in} -o {out} --tolerance 0.5"


@dataclass(frozen=True)
class Target:
    """A command and the folder that it reads."""

    name: str
    folder: Path
    words: str  # of the command; {in} is a copy of the folder, {out} where to write
    weight: float = 1.0  # how often it is drawn: less for a slow one

    def command(self, folder: Path, out: Path) -> list[str]:
        """Words for a copy of the folder."""
        places = {"in": str(folder), "out": str(out)}
        return [word.format(**places) for word in self.words.split()]


def make_targets(folder: Path) -> list[Target]:
    """Make the folders that are broken, and what the commands write of them whole: more folders."""
    folder.mkdir(exist_ok=True)
    with quick():
        sources, reports = [], []
        made = _sessions(folder), _files(folder), _recordings(folder), _outputs(folder)
        for target in chain(*made):
            sources.append(target)
            whole = whole_out(target)
            done = verify(*target.command(target.folder, whole))
            assert done.status in (0, 1, 3), (target, done)
            if (whole / "results").exists() and target.name not in SAME_REPORT:
                reports.append(Target(f"report of {target.name}", whole, REPORT, 0.5))
        own = folder / "own look"
        shutil.copytree(reports[0].folder, own)
        cv2.imwrite(str(own / "logo.png"), np.full((20, 40), 99, np.uint8))
        (own / "templates").mkdir()
        shutil.copy(ROOT / "reports" / "format" / "templates" / "report.css", own / "templates")
    words = f"{REPORT} --logo {{in}}/logo.png --template {{in}}/templates"
    return [*sources, *reports, Target("report's look", own, words)]


def whole_out(target: Target) -> Path:
    """Where a target's command writes for the whole folder."""
    return target.folder.parent / f"{target.name} whole"


def _simulated(folder: Path, name: str, text: str) -> Path:
    """Simulate a scenario; its file is kept in a folder of its own."""
    scenario = folder / f"{name} scenario" / "scenario.toml"
    scenario.parent.mkdir(parents=True)
    scenario.write_text(text)
    done = verify("simulate", scenario, "-o", folder / name)
    assert done.status == 0, done
    return folder / name


def _sessions(folder: Path) -> Iterator[Target]:
    """Sessions of pictures and of poses, and what is made of them."""
    rig = SMALL_BOARDS.partition("\n[rig]")[2].replace(
        "[640, 360]", "[640, 360]\ndistance_mm = 650.0"
    )
    arm = folder / "arm.toml"
    shutil.copy(ROOT / "robots" / "iust_6r.toml", arm)
    text = MINIMAL.replace("pairs = 3", "pairs = 12").replace('"iust_6r"', f'"{arm}"')
    text = text.replace("5.0, 5.0, 5.0, 5.0, 5.0, 5.0", AMPLITUDES) + f"{SESSION}[rig]{rig}"
    video = _simulated(folder, "video", text)
    pngs = _simulated(folder, "pngs", text.replace("[recording]", '[recording]\nformat = "png"'))
    yield Target("run", video, RUN, 2)
    yield Target("run PNGs", pngs, RUN)
    yield Target("run MJPEG", _filmed(folder / "mjpeg", video, "MJPG"), RUN, 0.5)
    yield Target("run open", _open_recording(folder / "open", video), RUN)
    poses = _poses(folder / "poses", video)
    yield Target("run poses", poses, RUN)
    yield Target("identify", poses, "identify {in} -o {out}")
    yield Target("simulate", video.with_name("video scenario"),
                 "simulate {in}/scenario.toml -o {out}")  # fmt: skip
    yield Target("check", video, "calibrate check {in} -o {out}")
    yield Target("plan", video, f"plan {{in}}/arm.toml {{in}} -o {{out}} {NEAR}", 0.2)
    register = "calibrate register {in} -o {out}.toml --marker {out}-leds.toml --report {out}"
    yield Target("register", video, f"{register} --known-marker {{in}}/marker.toml", 0.5)
    yield Target("emulate", video, "emulate labenc --motion {in}/encoders.csv")
    lab = folder / "lab"
    for name in ("one", "two"):
        shutil.copytree(poses, lab / name)
    yield Target("batch", lab, "batch {in} -o {out}")
    shutil.copytree(lab, folder / "kept" / "lab")
    verify("batch", folder / "kept" / "lab", "-o", folder / "kept" / "out")
    yield Target("batch again", folder / "kept", "batch {in}/lab -o {in}/out", 0.5)


def _poses(folder: Path, watched: Path) -> Path:
    """The poses of a session as another instrument would give them: true ones with its noise."""
    session, rng = open_session(watched), np.random.default_rng(1)
    q = np.radians(np.loadtxt(watched / "truth.csv", delimiter=",", skiprows=1)[:, 1:])
    poses = session.rig.rig_T_base @ robots.forward(session.arm, q)
    poses[:, :3, 3] += 2e-5 * rng.standard_normal((len(q), 3))
    noise = "position_standard_uncertainty_mm = 0.02\norientation_standard_uncertainty_deg = 1e-3\n"
    posed = write_posed(folder, watched, poses_csv(session.frames.t_left, poses), more=noise)
    shutil.copy(watched / "arm.toml", posed)
    return posed


def _open_recording(folder: Path, whole: Path) -> Path:
    """A recording that was cut off, its last two pairs in pending.raw alone."""
    shutil.copytree(whole, folder)
    facts = folder / "session.toml"
    facts.write_text(facts.read_text().replace("format = 1", 'format = 1\nrecording = "open"'))
    pairs = list(open_session(whole).pairs())
    shape = pairs[0].left.shape
    ring = UnfinishedPairs(folder / NAME, shape, shape, 2)
    later = pairs[-1].t_left - pairs[-3].t_left
    for pair in pairs[-2:]:
        times = {"t_left": pair.t_left + later, "t_right": pair.t_right + later}
        ring.put(pair.frame + 2, replace(pair, **times))
    return folder


def _files(folder: Path) -> Iterator[Target]:
    """Boards, robot files, stations."""
    boards = _simulated(folder, "boards", SMALL_BOARDS.format(pairs=6))
    where = "-o {out}.toml --report {out}"
    yield Target("boards", boards, f"calibrate boards {{in}} {where}", 0.3)
    filmed = _filmed(folder / "film of boards", boards, "FFV1")
    yield Target("film of boards", filmed, f"calibrate boards {{in}} {where}", 0.2)
    checked = "calibrate check {in} --rig {in}/rig_true.toml -o {out}"
    yield Target("check boards", boards, checked, 0.3)
    fixture = _simulated(folder, "fixture", SMALL_BOARDS.format(pairs=2) + FIXTURE)
    shutil.copy(boards / "rig_true.toml", fixture)
    words = "calibrate register {in} --rig {in}/rig_true.toml --board-in-base "
    yield Target("fixture", fixture, f"{words}{{in}}/board_in_base.toml {where}", 0.5)
    arms = folder / "arms"
    arms.mkdir()
    shutil.copy(ROOT / "robots" / "rv_3sd_melfa.toml", arms / "arm.toml")
    yield Target("robots", arms, "robots {in}/arm.toml")
    urdf = folder / "urdf"
    urdf.mkdir()
    shutil.copy(robots.library.example(robots.library.EXAMPLES["ur5"]), urdf / "arm.urdf")
    yield Target("robots URDF", urdf, "robots {in}/arm.urdf")
    station = folder / "station"
    station.mkdir()
    verify("run", station / "station.toml", "--new-station")
    text = (station / "station.toml").read_text().replace("30.0", "10.0")
    (station / "station.toml").write_text(text)
    yield Target("record", station, "record {in}/station.toml --for 2s -o {out}", 0.02)
    yield Target("doctor", station, "doctor {in}/station.toml", 0.5)
    for driver in ("rtde", "rosbridge", "opcua"):  # nobody answers: the keys alone are read
        network = folder / driver / "station.toml"
        network.parent.mkdir()
        verify("run", network, "--new-station", "--robot", "ur5", "--driver", driver)
        text = network.read_text().replace("192.168.0.20", "127.0.0.1").replace("30.0", "10.0")
        own = r"(?m)^# (stamp|cycle_ms|latency_ms|angle_unit|rate_hz) "
        network.write_text(re.sub(own, r"\1 ", text))
        yield Target(f"doctor {driver}", network.parent, "doctor {in}/station.toml", 0.2)
    watch = folder / "watch"
    watch.mkdir()
    beside = station_text(10.0).replace('"recordings"', '"../recordings"')
    (watch / "station.toml").write_text(beside)
    yield Target("watch", watch, "run {in}/station.toml --for 1s -o {out}", 0.02)
    grab = folder / "grab"
    shutil.copytree(folder / "video", grab / "film")
    (grab / "grab.toml").write_text(CELL)
    text = STATION.format(robot="rv_3sd_melfa", port="tcp:127.0.0.1:9")
    (grab / "station.toml").write_text(text)
    yield Target("grab", grab, "grab {in}/station.toml --target blue -o {out}")


def _recordings(folder: Path) -> Iterator[Target]:
    """Recordings of other programs: tables and a bag in, a session out."""
    tables, whole = folder / "tables", open_session(folder / "video")
    tables.mkdir()
    t, q = whole.encoders.t[:400], np.degrees(whole.encoders.q[:400])
    names = ";".join(("time [s]", *(f"J{joint}_deg" for joint in range(1, 7))))
    rows = np.column_stack([t, q])
    np.savetxt(tables / "log.csv", rows, "%.6f", ";", header=names, comments="")
    places = np.column_stack([t, 900 + q[:, :3], 0 * q[:, :3] + 5.0])
    names = "time [s],x_mm,y_mm,z_mm,A,B,C"
    np.savetxt(tables / "poses.csv", places, "%.6f", ",", header=names, comments="")
    words = (
        "convert {in}/log.csv {in}/poses.csv -o {out} --robot iust_6r --instrument tracker --yes"
    )
    yield Target("convert tables", tables, words, 2)
    bag = folder / "bag"
    bag.mkdir()
    (mcap,) = write_bag(folder / "ros2", bag_of("mcap", whole)).glob("*.mcap")
    shutil.copy(mcap, bag / "bag.mcap")
    words = "convert {in}/bag.mcap -o {out} --robot iust_6r"
    yield Target("convert bag", bag, words, 0.5)
    foxglove = folder / "foxglove"
    foxglove.mkdir()
    write_mcap(foxglove / "bag.mcap", whole, "json")
    yield Target("convert foxglove", foxglove, words, 0.3)
    yield Target("convert out", folder / "video", "convert {in} -o {out} --to mcap", 0.5)


def _filmed(folder: Path, pictures: Path, codec: str) -> Path:
    """The same with its pictures in videos of another codec, as a webcam gives them."""
    shutil.copytree(pictures, folder)
    for side in ("left", "right"):
        (old,) = folder.glob(f"{side}*")
        images = list(open_images(old).images())
        kind, size = cv2.VideoWriter.fourcc(*codec), images[0].shape[1::-1]
        film = cv2.VideoWriter(str(folder / f"{side}.avi"), kind, 10.0, size, images[0].ndim == 3)
        for image in images:
            film.write(image)
        film.release()
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    if (facts := folder / "session.toml").exists():
        facts.write_text(facts.read_text().replace(".mkv", ".avi"))
    return folder


def _outputs(folder: Path) -> Iterator[Target]:
    """What some of the commands above wrote, as the input of others."""
    registered = folder / "registered"
    shutil.copytree(folder / "video", registered)
    shutil.copy(folder / "register whole.toml", registered / "rig.toml")
    shutil.copy(folder / "register whole-leds.toml", registered / "marker.toml")
    yield Target("run registered", registered, RUN, 0.5)
    yield Target("run identified", folder / "identify whole" / "sessions" / "poses", RUN, 0.5)
    verify("grab", "--sim", "--small", "--seed", "4", "-o", folder / "grabbed")
    yield Target("report of grab", folder / "grabbed", REPORT, 0.3)


class _PoolHere:
    """Workers of a batch, in this process."""

    def __init__(self, _workers: int) -> None:
        pass

    def ready(self) -> None:
        pass

    def close(self) -> None:
        pass

    def run(self, tasks: Any) -> Iterator[tuple[Any, Any]]:
        while tasks:
            task = tasks.popleft()
            yield task, perform(task)


@contextmanager
def quick() -> Iterator[None]:
    """Leave out what takes long and reads nothing: PDF, processes, waits for devices."""
    with ExitStack() as stack:
        for name, instead in (
            ("reports.format.pdf.pages", lambda *_: b"%PDF-1.7"),
            ("verify.fleet.batch.workers.ProcessPool", _PoolHere),
            ("verify.simulation.emulators.server.EmulatorServer.serve", lambda *_: None),
            ("verify.cli.doctor.devices.START_TIMEOUT", 1.0),
            ("verify.cli.doctor.devices.WATCH_TIME", 0.05),
            ("verify.cli.grab.station._open_devices", lambda *_: (None, None)),
            ("verify.cli.grab.station.LivePairs", lambda *_: SimpleNamespace(close=lambda: None)),
            ("verify.cli.grab.station.conduct", lambda *_, **__: True),
        ):
            stack.enter_context(patch(name, instead))
        stack.enter_context(planning.few_postures())
        yield
