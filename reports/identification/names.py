"""Names of an arm's parameters in words: offset_3 is "joint 3, offset"."""

import re

KINDS = {
    "offset": "offset", "a": "link length a", "d": "link offset d", "alpha": "twist α",
    "beta": "twist β",
}  # fmt: skip
AXES = {axis: axis for axis in "xyz"} | {f"r{axis}": f"turn about {axis}" for axis in "xyz"}
LINK = re.compile(r"(offset|a|d|alpha|beta)_(\d+)")
PLACE = re.compile(r"(base|tool)(?:_(\d+))?_(r?[xyz])")


def in_words(name: str) -> str:
    """Say which parameter a name stands for; a name of no known form stays as it is."""
    if link := LINK.fullmatch(name):
        return f"joint {link[2]}, {KINDS[link[1]]}"
    if place := PLACE.fullmatch(name):
        which = f" {place[2]}" if place[2] else ""
        return f"{place[1]}{which}, {AXES[place[3]]}"
    return name
