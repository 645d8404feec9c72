"""The report of a planned session, in words: kinds, figures, notes."""

from reports.calibration_words import Said

KINDS = {
    "offsets": "Offset",
    "gains": "Gain",
    "backlash": "Backlash",
    "eccentricity": "Eccentricity",
}
CLOCKS = {
    "estimated": "found from the motion",
    "given": "given",
    "not_observable": "the motion does not show it",
}
REASONS = {"gauge": "gauge", "not_supported": "not supported"}


class Words:
    """Sentences, and notes that stand under tables."""

    SAME_JUDGEMENT = (
        "Predicted by the judgement itself, from the spots that this motion would show: what the "
        "run's report will state, if the session is as assumed below and nothing is at fault."
    )
    OBSTACLES = (
        "Obstacles and cables are not known to the plan: bring the arm to the first pose and try "
        "the motion slowly first."
    )
    JOINTS = (
        "U: expanded uncertainty of the joint's mean error (k as stated). Detectable: the smallest "
        "constant offset that would be noticed (false alarm 0.1 %, power 80 %). Separable: the "
        "smallest that would be told from an offset of any other joint. Visible: the share of an "
        "offset that was there at registration. The mean weighs every pair alike; the fit "
        "that notices an offset learns from the whole motion what rig and LEDs are off by, and may "
        "notice less than U."
    )
    SOURCES = (
        "Standard uncertainties; the largest is the one to mend first. What does not average out "
        "is no smaller for a longer session."
    )
    HIDDEN = (
        "Base or LEDs were registered through the robot's own encoders: what a registration from "
        "these hides of an offset, no motion shows."
    )
    KINDS = (
        "u: standard uncertainty with all kinds that were asked for found together. Detectable: "
        "the smallest that would be noticed if it were alone. A dash: this motion does not show it."
    )
    SPAN = (
        "Upward: the share of pairs whose last travel was upward. Backlash shows where both "
        "directions occur."
    )
    EXCLUDED = "Each posture counts once, under the first that excludes it, in this order."
    GEOMETRY = (
        "Standard uncertainty of what `verify identify` would find with base and LEDs held as "
        "their files state them. A gauge is told apart by no motion."
    )


FIGURES = {
    "plan_detectable": Said(
        "Predicted of each joint: expanded uncertainty of its mean error, and the smallest "
        "constant offset that would be noticed.",
        "Two upright bars a joint, in degrees.",
        "No joint's offset would show.",
    ),
    "correlation": Said(
        "Predicted correlation of the joints' mean errors.",
        "A square matrix of correlation coefficients, one row and one column a joint.",
        "The correlation of the joints' mean errors is not known.",
    ),
    "plan_joints": Said(
        "The joints over time.",
        "Strips over time, one a joint, in degrees.",
        "The motion was not kept.",
    ),
    "plan_path": Said(
        "The flange's way, the arm at some of the poses, and the cameras with their view; robot's "
        "base frame.",
        "Lines in space: the flange's way, the arm's links, the cameras' axes.",
        "The arm's way was not kept.",
    ),
    "plan_view": Said(
        "The LEDs in both pictures, all pairs of the session.",
        "Two pictures with the places of every LED in them, in pixels.",
        "The LEDs' places were not kept.",
    ),
}
