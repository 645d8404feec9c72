"""Terms of the reports and their meanings, word for word those of docs/glossary.md."""

import re
from functools import cache

from reports.document.blocks import Document, Table

TERMS = {
    "alarm": (
        "what a watched robot has raised: a joint's error beyond its limit, a device that is "
        "silent, a defect"
    ),
    "apparent LED centre": (
        "where the light of an LED seems to come from; it moves a little with the viewing angle"
    ),
    "arm": "the robot from its base to its flange, without tool",
    "base": "the robot's DH frame 0; rig_T_base says where it stands in the rig",
    "cause": (
        "a fault that explains the errors better than every rival: an offset, a gain, backlash, …"
    ),
    "clock offset": "what is added to the encoders' time to get the cameras' time",
    "conform": (
        "the error is within its tolerance at every pose of the session, with a stated probability"
    ),
    "detectable error": (
        "the smallest constant offset that is detected: false alarm 0.1 %, power 80 %"
    ),
    "encoder error": "reading less true angle; positive where the encoder reads too high",
    "expanded uncertainty, U": (
        "k times the standard uncertainty; k = 2, or more where few data show the noise"
    ),
    "flange": "the robot's last DH frame, where tools are mounted and the LEDs sit",
    "largest error": "of a joint: the resolved error of largest magnitude over the measured pairs",
    "LED body": (
        "the piece that carries the LEDs, with their places in the flange's frame (marker.toml)"
    ),
    "mean error": (
        "of a joint: the mean of the resolved error over the measured pairs; mean_error_deg"
    ),
    "merged spot": "light of two LEDs, or of one that is half hidden, taken as one spot",
    "outlier": (
        "a pair whose spots contradict each other or the pair's neighbours; it is not measured"
    ),
    "pair": "a left and a right picture of one moment, as far as the cameras manage",
    "pan": "the turn of a camera on its base",
    "registration": (
        "finding where the robot stands in the rig, and where the LEDs sit on the flange"
    ),
    "resolved error": (
        "the smooth curve through a joint's pair errors on which the verdict rests; causes are "
        "in it"
    ),
    "rig": "two cameras on their turning bases, calibrated: rig.toml",
    "separable error": (
        "the smallest constant offset of a joint that can be attributed to that joint alone"
    ),
    "session": "one recorded run: a folder",
    "spot": "the picture of one LED",
    "standard uncertainty, u": "one standard deviation of what the error of a figure may be",
    "station": "cameras, encoders and their ports, for a robot that is watched",
    "taken as exact": (
        "of a source whose uncertainty nobody stated: the verdict holds on that condition"
    ),
    "tolerance": "the largest error allowed, at every pose",
    "undecided": "the uncertainty is too large to say whether the error is within its tolerance",
    "visible share": (
        "how much of an offset's effect is left after all that was fitted through the same encoders"
    ),
}

# how headings and heads of columns write a term, where they do not write it out
SPELLINGS = {
    "conform": r"conforms?",
    "detectable error": r"detectable(?: errors?)?",
    "expanded uncertainty, U": r"expanded uncertainty|(?-i:U)",
    "resolved error": r"resolved errors?|ê",
    "separable error": r"separable(?: errors?)?",
    "standard uncertainty, u": r"standard uncertainty|(?-i:u)",
    "visible share": r"visible(?: shares?)?",
}


@cache
def _pattern() -> re.Pattern[str]:
    """One group a term; where several begin at one letter, the longest wins."""
    ordered = sorted(TERMS, key=len, reverse=True)
    parts = (f"({SPELLINGS.get(term, f'{re.escape(term)}s?')})" for term in ordered)
    return re.compile(rf"(?<!\w)(?:{'|'.join(parts)})(?!\w)", re.IGNORECASE)


def find_term(text: str) -> tuple[int, int, str] | None:
    """Find the first term that a heading holds: start, end and the term; None for none."""
    found = _pattern().search(text)
    if found is None or found.lastindex is None:
        return None
    return found.start(), found.end(), sorted(TERMS, key=len, reverse=True)[found.lastindex - 1]


def anchor(term: str) -> str:
    """Name a term's place in a page."""
    return "term-" + re.sub(r"[^a-z]+", "-", term.lower()).strip("-")


def terms_of(document: Document) -> dict[str, str]:
    """Collect the terms of a document's headings and heads of columns, in order of the alphabet."""
    texts = [section.title for section in document.sections]
    for section in document.sections:
        for block in section.blocks:
            texts += block.head if isinstance(block, Table) else ()
    found = {place[2] for place in map(find_term, texts) if place}
    return {term: TERMS[term] for term in sorted(found, key=str.lower)}
