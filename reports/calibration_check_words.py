"""The report of an interim check, in words: verdicts, figures, notes."""

from reports.calibration_words import Said

CHECKED = {
    "held": ("conform", "The calibration holds"),
    "not_held": ("nonconform", "The calibration does not hold"),
}
KEYS = {"scale": ("scale_permille", "‰"), "vertical": ("vertical_px", "px"),
        "roll": ("roll_deg", "°")}  # fmt: skip
NAMES = {
    "scale": "Scale of known lengths",
    "vertical": "Height between the images",
    "roll": "Roll between the images",
}
UNITS = {"deg": "°"}


class Words:
    """Notes that stand under tables."""

    UNSTATED = "No uncertainty is stated for {}: taken as exact, and the verdict rests on that."
    FIGURES = (
        "Scale: measured length over known, less 1. Height: by how much the right image lies below "
        "where the left one says. Roll: by how much it is turned against it, clockwise. A camera "
        "that was knocked shifts at least one of them; a turn of both together shifts none."
    )
    LENGTHS = (
        "The uncertainty counts what the rig, the known length and the pictures state. Lengths "
        "share most of it, so they err together."
    )
    VISIBLE = "A dash: however large, these figures do not show it."


FIGURES = {
    "lengths": Said(
        "Error of each known length, with its expanded uncertainty (k = 2) as a bar about it.",
        "Points with upright bars, one a known length: measured less known in millimetres.",
        "No length was kept.",
    ),
    "figures": Said(
        "The figures in units of their standard uncertainty; beyond the dotted limits the "
        "calibration does not hold.",
        "A point a figure, between two level lines that are the limits.",
        "The figures are not known.",
    ),
    "over_pairs": Said(
        "The figures of single pairs. The dashed line is what all pairs give together; pairs "
        "scatter about it by the pixels' noise.",
        "Three strips over the pairs: scale in thousandths, height in pixels, roll in degrees.",
        "One pair alone: there is nothing to see pair by pair.",
    ),
}
