"""The error for a robot's description that cannot be used."""

from pathlib import Path


class RobotError(Exception):
    """A robot cannot be used as described; the message is one line.

    The place is the file, with the line or key at fault, or the robot's name; then the value there,
    what would be right, and what the user can do about it.
    """

    def __init__(self, place: str | Path, found: str, expected: str = "", remedy: str = "") -> None:
        remedy = remedy or "Correct it there."
        self.place, self.found, self.expected, self.remedy = str(place), found, expected, remedy
        clause = f"{found}; {expected}" if expected else found
        sentence = f"{place}: {clause}. {remedy}".strip()
        # names come from files: no newline or escape sequence may break the one line
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in sentence))
