"""Write docs/commands.md, every command's --help: `python -m tests.support.commands`."""

from pathlib import Path

from tests.support.command import verify

PAGE = Path(__file__).parents[2] / "docs" / "commands.md"
COMMANDS = (
    "run", "batch", "identify", "plan", "grab", "report", "calibrate boards",
    "calibrate register", "calibrate check", "board", "simulate", "robots", "emulate", "doctor",
    "demo",
)  # fmt: skip
HEAD = """# Commands

What each command says of itself. `python -m tests.support.commands` writes this page.

Tab completes commands and options once `--install-completion` has been given, alone.
"""


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for command in COMMANDS:
        text = verify(*command.split(), "--help").out.strip()
        parts.append(f"## verify {command}\n\n```text\n{text}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
