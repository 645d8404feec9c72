"""Sentences for machine words: verdicts, reasons, statuses, sources."""

from functools import partial
from typing import Any

from reports.document.blocks import Cell, uncertain_field
from reports.document.formatting import (
    COVERAGE_FACTOR,
    DASH,
    coverage_text,
    exact_number,
    finite,
    lookup_label,
    percent,
)

# a joint's error with U = k u, k the joint's own: 2, or more where few pairs show the noise
with_expanded = partial(uncertain_field, k=2.0, k_key="coverage_factor")
worst_error = partial(with_expanded, "worst_error_deg", "worst_error_standard_uncertainty_deg")


def coverage(joints: list[dict[str, Any]]) -> str:
    """Say the coverage factors of the joints' errors: k = 2, or k = 2 to 2.19."""
    return coverage_text(*(joint.get("coverage_factor") for joint in joints))


def sum_factor(joints: list[dict[str, Any]]) -> float:
    """K of a sum of joints' errors: the largest of theirs, whose noise rests on the same pairs."""
    known = [k for joint in joints if (k := finite(joint.get("coverage_factor"))) is not None]
    return max(known, default=COVERAGE_FACTOR)


# visible shares of an offset
MAX_HIDDEN_SHARE = 0.005  # shown as 0 %: nothing of the offset is left
MAX_MOSTLY_HIDDEN_SHARE = 0.3  # the share at which the smallest visible offset triples
MAX_PARTLY_HIDDEN_SHARE = 0.9

VERDICTS = {"conform": "conforms", "nonconform": "does not conform", "undecided": "undecided"}

REASONS = {
    "": "",
    "within_tolerance": "within tolerance at every pose",
    "exceeds_tolerance": "exceeds the tolerance",
    "uncertainty_too_large": "uncertainty too large for this tolerance",
    "clock_ambiguous": "depends on which of several clock offsets is right",
    "not_detectable": "an error of the tolerance's size could go unnoticed",
    "lack_of_fit": "errors follow no known curve",
    "pairs_lost": "the pairs that could be measured do not bear a verdict",
    "not_observable": "cannot show in this session",
    "no_tolerance": "no tolerance given",
}

STATUSES = {
    "measured": "measured",
    "too_few_leds": "too few LEDs seen",
    "ambiguous_leds": "LEDs could not be identified",
    "no_encoder": "no encoder reading at that time",
    "unreachable": "pose out of the arm's reach",
    "outlier": "LEDs do not fit the marker",
    "unaligned": "not of one instant, or repeated",
}

CHOICES = {
    "geometry": "by the marker's geometry alone",
    "colour": "by the LEDs' colours",
    "continuity": "by continuity with the pair before",
    "encoders": "by the encoder readings (the choice only, never the value)",
}

CLOCK_SOURCES = {
    "estimated": "estimated from the motion",
    "ambiguous": "one of several that the motion allows",
    "arrival": "from the readings' arrival times",
    "none": "not shown by the motion",
    "given": "given with the session",
    "session": "given with the session",
    "stated": "given with the session",
}

SOURCES = {
    "fixture": "by a fixture, independently of the encoders",
    "motion": "from a motion, through the robot's own encoders",
    "jig": "from a jig keyed to the flange",
    "measured": "measured in the marker's own frame",
    "board": "from a board at a known place",
}

COUPLINGS = {
    "singularity": "the joints' axes line up: only the sum is determined",
    "well_known": "known better than its members",
    "self_motion": "of more than six joints a pose determines six sums; shares as at mid-session",
}


def verdict_text(verdict: Any, reason: Any) -> str:
    """Say a verdict, with its reason where the verdict alone does not say it."""
    label = lookup_label(VERDICTS, verdict)
    if not reason or reason in ("within_tolerance", "exceeds_tolerance"):
        return label
    return (
        lookup_label(REASONS, reason)
        if label == DASH
        else f"{label}: {lookup_label(REASONS, reason)}"
    )


def verdict_cell(entry: dict[str, Any]) -> Cell:
    """The cell of a table that holds a verdict and its reason."""
    verdict = entry.get("verdict")
    return Cell(verdict_text(verdict, entry.get("reason")), tone(verdict))


def tolerance(value: Any) -> str:
    """Write a tolerance as the bound that it is on either side."""
    bound = exact_number(value)
    return bound if bound == DASH else f"±{bound}"


def tone(verdict: Any) -> str:
    """Give the tone of a verdict: its machine word, or none."""
    return str(verdict) if verdict in VERDICTS else "none"


def visibility(joint: dict[str, Any]) -> str:
    """Say in words what this session could see of a constant offset of one joint."""
    fraction = finite(joint.get("visible_fraction"))
    since = finite(joint.get("visible_fraction_since_registration"))
    if fraction is None:
        return "Not determined: too few measured pairs."
    if fraction < MAX_HIDDEN_SHARE:
        text = "An offset that was there at registration is invisible."
    elif fraction < MAX_MOSTLY_HIDDEN_SHARE:
        text = f"Mostly hidden: {percent(fraction)} of an offset at registration shows."
    elif fraction < MAX_PARTLY_HIDDEN_SHARE:
        text = f"Partly hidden: {percent(fraction)} of an offset shows."
    else:
        return "An offset shows in full."
    if since is not None and since >= MAX_PARTLY_HIDDEN_SHARE:
        text += " One that arose later shows in full."
    return text
