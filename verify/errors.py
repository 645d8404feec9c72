"""What can be wrong with what a user gives us, worded once: place, found, expected, what to do."""

from pathlib import Path

MAX_PART = 1000  # characters of a place, a finding or an expectation in one line


class InputError(Exception):
    """The input cannot be used; said in one line, exit status 2.

    The place is the file (and line, column or key) or the option at fault; then what stands there,
    what would be right, and what the user can do about it.
    """

    def __init__(self, place: str | Path, found: str, expected: str = "", remedy: str = "") -> None:
        remedy = remedy or (
            "Give another value." if str(place)[:2] == "--" else "Correct it there."
        )
        self.place, self.found, self.expected, self.remedy = str(place), found, expected, remedy
        place, found, expected = (_clip(part) for part in (str(place), found, expected))
        clause = f"{found}; {expected}" if expected else found
        super().__init__(one_line(f"{place}: {clause}. {remedy}".strip()))

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str]]:
        """Cross from one process to another: an exception's own way keeps only the sentence."""
        return type(self), (self.place, self.found, self.expected, self.remedy)


def _clip(text: str) -> str:
    """Shorten what a file holds, so that its size does not hide what the line says."""
    return text if len(text) <= MAX_PART else f"{text[: MAX_PART - 1]}…"


class WatchDefectError(Exception):
    """A watch could not go on; said in one line, exit status 70."""


def defect_text(error: BaseException) -> str:
    """Say that an error is this program's own, where a run outlives it."""
    return f"a defect of this program, {type(error).__name__}: {error}"


def one_line(text: str) -> str:
    """Keep hostile names (newlines, escape sequences) from breaking the promised one line."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
