"""Write docs/commands.md, every command's --help: `python -m tests.support.commands`."""

import re
from pathlib import Path

from tests.support.command import verify

PAGE = Path(__file__).parents[2] / "docs" / "commands.md"
COMMANDS = (
    "run", "record", "batch", "identify", "plan", "grab", "report", "calibrate boards",
    "calibrate register", "calibrate check", "convert", "board", "simulate", "robots", "emulate",
    "doctor", "demo",
)  # fmt: skip
HEAD = """# Commands

What each command says of itself. `python -m tests.support.commands` writes this page.

Tab completes commands and options once `--install-completion` has been given, alone.
"""


def page() -> str:
    """The whole page: a list of the commands, then what each says of itself."""
    helps = {command: verify(*command.split(), "--help").out.strip() for command in COMMANDS}
    rows = [
        f"| [verify {command}](#verify-{command.replace(' ', '-')}) | {first_sentence(text)} |"
        for command, text in helps.items()
    ]
    parts = [HEAD, "\n".join(["| command | what it does |", "|---|---|", *rows, ""])]
    for command, text in helps.items():
        parts.append(f"## verify {command}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)


def first_sentence(text: str) -> str:
    """What a command does, from its help: the paragraph behind the usage."""
    return re.sub(r"\s+", " ", text.split("\n\n")[1]).strip()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
