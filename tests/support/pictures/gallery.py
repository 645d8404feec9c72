"""Every kind of report and page, made by the commands that a user types: docs/gallery.md."""

import subprocess
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.support.devices.chromium import Browser, Tab, launched
from tests.support.pictures import stamp
from tests.support.pictures.first_page import first_page_of

WIDTH_PX = 900  # of a page in the browser
PIXELS_PER_INCH = 96  # an A4 page is 794 px wide
WINDOW = (1280, 900)  # px, of the browser
PORT = 8747
PAGE = stamp.ROOT / "docs" / "gallery.md"
SAMPLE = "sample_sessions/multi_joint_fault_6r"


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture of the gallery: the commands behind it, the last one's report or page."""

    name: str
    title: str
    text: str
    commands: tuple[str, ...]
    out: str = ""  # folder of the report; "": the page that the command serves
    ready: str = ""  # of a page: the expression that is true once it shows what it is for


HEAD = """# Gallery of reports and pages

The first page of every kind of report, and both pages for the browser. Under each title stand the
commands that made it here, on simulated data. `make pictures` makes them again.
"""
GALLERY = (
    Shown("run", "Run",
        "Does the robot conform, which joint is off, by how much, and what to do.",
        (f"verify run {SAMPLE} -o demo-report --tolerance 0.2",), "demo-report"),
    Shown("fleet", "Fleet",
        "Many sessions: which arm, which joint, since when.",
        ("verify batch sample_sessions -o fleet-report",), "fleet-report"),
    Shown(
        "calibration", "Calibration",
        "How well the cameras are known, and where the board was not shown.",
        ("verify simulate boards_turning -o my_boards",
         "verify calibrate boards my_boards -o rig.toml"), "my_boards-calibration",
    ),
    Shown(
        "registration", "Registration",
        "Where the robot stands and the LEDs sit, and what that hides.",
        ("verify simulate multi_joint_fault_6r -o my_session",
         "verify calibrate register my_session -o registered.toml --marker marker.toml"),
        "my_session-registration",
    ),
    Shown("check", "Check",
        "Does the calibration still hold.",
        (f"verify calibrate check {SAMPLE} -o check-report",), "check-report"),
    Shown(
        "plan", "Plan",
        "How well the next session will determine each joint, before anyone moves.",
        (f"verify plan iust_6r {SAMPLE}/rig.toml --marker {SAMPLE}/marker.toml -o next_session",),
        "next_session",
    ),
    Shown("identify", "Identification",
        "The arm's own offsets, lengths and twists, and how much better it then predicts.",
        (f"verify identify {SAMPLE} -o arm-report",), "arm-report"),
    Shown(
        "grab", "Grasp",
        "What was grasped, how, and how long each step took.",
        ("verify grab --sim --small --execute --auto -o grab-report",), "grab-report",
    ),
    Shown(
        "watch_page", "Page of a watch",
        "The robot as it moves: errors against tolerance, pictures, alarms. It takes no orders.",
        ("verify run --new-station station.toml",
         "verify run station.toml --for 180s --tolerance 0.5 --page"),
        ready="/all joints within/.test(document.querySelector('#overall').textContent)",
    ),
    Shown(
        "grab_page", "Page of a grasp",
        "The object, the plan, and the stop button, which replaces no emergency stop.",
        ("verify grab --sim --small --execute --page --target blue --for 180s",),
        ready="document.querySelector('#plan-words').textContent.startsWith('planned')",
    ),
)  # fmt: skip
NAMES = tuple(shown.name for shown in GALLERY)
READY_MS = 150_000  # until a page shows what it is for
FILLING_MS = 12_000  # of a page's curves, once it is there


def make(folder: Path, names: Collection[str]) -> None:
    """Run the commands of some pictures in a folder, draw what they leave."""
    (folder / "sample_sessions").symlink_to(stamp.ROOT / "sample_sessions")
    for shown in (one for one in GALLERY if one.name in names):
        if shown.out:
            for command in shown.commands:
                typed(command, folder)
            stamp.write(f"gallery_{shown.name}", first_page_of(folder / shown.out, PIXELS_PER_INCH))
        else:
            for command in shown.commands[:-1]:
                typed(command, folder)
            page = screenshot(shown, folder)
            stamp.write(f"gallery_{shown.name}", page, width=WIDTH_PX)


def page() -> str:
    """The page that shows them all."""
    parts = [HEAD]
    for shown in GALLERY:
        parts.append(f"## {shown.title}\n\n{shown.text}\n\n```text")
        parts.append("\n".join(shown.commands))
        parts.append("```\n")
        name = f"gallery_{shown.name}.png"
        if (stamp.FOLDER / name).exists():
            what = "first page" if shown.out else "in the browser"
            parts.append(f"![{shown.title}, {what}](pictures/{name})\n")
    return "\n".join(parts)


def typed(command: str, folder: Path) -> None:
    """Run a command as a user types it; 1 and 3 are verdicts."""
    done = subprocess.run(words(command), cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 1, 3):
        raise RuntimeError(f"{command}\n{done.stderr}")


def words(command: str) -> list[str]:
    """Words of a command line, by this interpreter's own `verify`."""
    name, *rest = command.split()
    assert name == "verify"
    return [sys.executable, "-u", "-m", "verify", *rest]  # -u: a page's address is read at once


def screenshot(shown: Shown, folder: Path) -> bytes:
    """Run a command that serves a page; the page as the browser shows it, PNG."""
    with serving([*words(shown.commands[-1]), "--page-port", str(PORT)], folder) as url:
        chromium = folder / "browser"
        chromium.mkdir(exist_ok=True)
        with launched(chromium) as browser, opened(browser, url) as tab:
            tab.page.set_default_timeout(READY_MS)
            tab.until(shown.ready)
            tab.page.wait_for_timeout(FILLING_MS)
            return tab.page.screenshot()


@contextmanager
def serving(command: list[str], folder: Path) -> Iterator[str]:
    """Keep a command running until its page has been looked at; the page's address."""
    with subprocess.Popen(
        command, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith("page: "):
                    yield line.removeprefix("page: ").strip()
                    return
            raise RuntimeError(f"{' '.join(command)} serves no page")
        finally:
            process.kill()


@contextmanager
def opened(browser: Browser, url: str) -> Iterator[Tab]:
    """Look at a page."""
    with browser.open(url, *WINDOW) as tab:
        yield tab
