"""The report of a registration, in words: methods, figures, notes."""

from reports.calibration_words import FIGURES as CALIBRATION
from reports.calibration_words import Said

METHODS = {
    "motion": "from the robot's own motion, through its own encoders",
    "fixture": "from a board at a known place on the base",
    "sweeps": "from sweeps of single joints",
}


class Words:
    """Notes that stand under tables."""

    FREED = (
        "What hides is what the base and the LEDs took in with the encoders' own errors. A base "
        "from a fixture and LEDs from a jig hide nothing. An offset that arises later shows in "
        "full."
    )
    LEDS = (
        "What hides is what the LEDs took in with the encoders' own errors. LEDs from a jig hide "
        "nothing. An offset that arises later shows in full."
    )
    WORSE = (
        "Pairs that were held out fit clearly worse than those that were registered on: something "
        "moves that is held fixed here, or the motion is too poor. Look at the residuals over time."
    )
    THROUGH = (
        "Stated for encoders without errors of their own; what a constant offset of a joint moves "
        "with it is in the absorption matrix of rig.toml."
    )
    HELD_BASE = "The base was held as the rig had it."
    HELD_LEDS = "The LEDs were held as the marker had them."
    NOTHING_HIDDEN = (
        "The robot's encoders took no part in finding its base, so the base hides nothing of their "
        "errors. What LEDs hide that were found through the encoders is said by their own "
        "registration."
    )
    NOT_KNOWN = "What the registration hides is not known."
    VISIBLE = (
        "Base and LEDs were fitted to the same encoders, so an offset that was there already moved "
        "them with it; visible is the share of its signal that is left. One that arises later "
        "shows in full in every session that is measured with this registration."
    )
    HOLD_OUT = "Where both are alike, the registration carries over to poses that it has not seen."
    FIXTURE = (
        "χ² of six degrees of freedom: above 22.5 once in a thousand by chance. A pair beyond it "
        "saw the board or a base move."
    )
    AXES = "Compared without the registration: cameras alone. False alarm: 0.1 % over all rows."
    GEARS = "1 where the encoder turns as the joint does; it needs neither base nor table."
    NO_SWEEPS = "No joint was swept alone, so the axes were not compared with the table."


FIGURES = {
    "visible": Said(
        "Visible share of a constant offset of each joint that was there at registration.",
        "Bars, one a joint: visible share in percent.",
        "What the registration hides is not known.",
    ),
    "over_time": Said(
        "RMS residual of each pair's spots. A registration that no longer holds rises from some "
        "pair on.",
        "Two strips over the pairs: rms residual in pixels, left and right camera.",
        "The residuals were not kept.",
    ),
    "vectors": Said(
        "Residuals of the spots over the image, magnified as the arrow on top says: thin lines for "
        "spots, arrows for their means over cells.",
        CALIBRATION["vectors"].alt,
        "The residuals were not kept.",
    ),
    "linearity": Said(
        "Encoder less turn about the joint's own axis over its sweep, a straight line taken out.",
        "Strips over the reading, one a joint, in degrees.",
        "The sweeps were not kept.",
    ),
}
