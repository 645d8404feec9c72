"""Where `make bench` keeps its figures: JSON, a benchmark an entry, with its machine and commit.

    {"machine": {...}, "benches": {"chain": {"date": ..., "commit": ..., "figures": [...]}, ...}}

A benchmark that runs again replaces its own entry; another machine begins anew. From this file
`python -m tests.bench page` writes the tables of docs/performance-of-the-program.md.
"""

import json
import os
import platform
import subprocess
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from tests.bench.goals import Figure

ROOT = Path(__file__).parents[2]
FILE = ROOT / "build" / "bench.json"
PAGE = ROOT / "docs" / "performance-of-the-program.md"
BEGIN, END = "<!-- {}: python -m tests.bench page -->", "<!-- end of {} -->"
LIBRARIES = ("numpy", "cffi", "opencv-python-headless", "scipy", "pandas", "typst")

Records = dict[str, Any]


def machine() -> dict[str, Any]:
    """What the figures hold for: processor, cores that may be used, versions."""
    info = Path("/proc/cpuinfo")
    models = [
        line.partition(":")[2].strip()
        for line in (info.read_text().splitlines() if info.exists() else [])
        if line.startswith("model name")
    ]
    return {
        "processor": models[0] if models else platform.processor(),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "libraries": {name: metadata.version(name) for name in LIBRARIES},
    }


def commit() -> str:
    """The commit that is measured, with a + where files differ from it."""
    words = ["git", "describe", "--always", "--dirty=+"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def keep(path: Path, name: str, figures: list[Figure]) -> None:
    """Put a benchmark's figures into the file, in place of its earlier ones."""
    records: Records = {"machine": machine(), "benches": {}}
    if path.is_file():
        earlier = json.loads(path.read_text())
        if earlier["machine"] == records["machine"]:
            records = earlier
    records["benches"][name] = {
        "date": datetime.now(UTC).date().isoformat(),
        "commit": commit(),
        "figures": [figure.record() for figure in figures],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(records, indent=1, ensure_ascii=False) + "\n")


def figures(records: Records, name: str | None = None) -> list[Figure]:
    """The figures of one benchmark, or of all."""
    benches = records["benches"]
    chosen = benches.values() if name is None else [benches[name]] if name in benches else []
    return [
        Figure(
            one["name"], one["value"], one["unit"], one["at_most"], one["at_least"],
            along=one.get("along", ""), at=one.get("at", 0.0),
        )
        for bench in chosen
        for one in bench["figures"]
    ]  # fmt: skip


def write_page(path: Path = FILE, page: Path = PAGE) -> None:
    """Write the tables of the page anew, between their marks."""
    records = json.loads(path.read_text())
    text = page.read_text(encoding="utf-8")
    for name, table in {
        "goals": _goals(records), "figures": _others(records), "growth": _growth(records),
        "machine": _machine(records),
    }.items():  # fmt: skip
        before, _, rest = text.partition(BEGIN.format(name))
        _, _, after = rest.partition(END.format(name))
        inner = f"{BEGIN.format(name)}\n\n{table}\n\n{END.format(name)}"
        text = f"{before}{inner}{after}"
    page.write_text(text, encoding="utf-8")


def _machine(records: Records) -> str:
    found = records["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in found["libraries"].items())
    dates = sorted({bench["date"] for bench in records["benches"].values()})
    when = dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
    return (
        f"Measured on {when}: {found['processor']}, {found['cores']} cores; "
        f"Python {found['python']}, {libraries}."
    )


def _goals(records: Records) -> str:
    rows = [f for f in figures(records) if f.goal and not f.along]
    held = ["yes" if f.holds else "**no**" for f in rows]
    lines = [
        f"| {f.name} | {f.shown(f.value)} | {f.goal} | {word} |"
        for f, word in zip(rows, held, strict=True)
    ]
    return "\n".join(["| figure | measured | goal | holds |", "|---|--:|--:|---|", *lines])


def _others(records: Records) -> str:
    rows = [f for f in figures(records) if not f.goal and not f.along]
    lines = [f"| {f.name} | {f.shown(f.value)} |" for f in rows]
    return "\n".join(["| figure | measured |", "|---|--:|", *lines])


def _growth(records: Records) -> str:
    lines = [
        f"| {f.name} | {f.along} | {f.at:.3g} | {f.shown(f.value)} |"
        for f in figures(records, "growth")
    ]
    return "\n".join(["| what | along | at | measured |", "|---|---|--:|--:|", *lines])
