"""The report of an identified arm, in words: models, figures, notes."""

from reports.calibration_words import Said

LEVELS = {
    "registration": "base and tool alone",
    "offsets": "with the joints' offsets",
    "geometry": "with all of the arm's geometry",
}
REASONS = {
    "gauge": "gauge",
    "not_supported": "not supported",
    "not_called_for": "not called for",
}


class Words:
    """Notes that stand under tables."""

    SIGN = (
        "Error: encoder less measured. A correction is its negative: it is to be added to the "
        "reading. ± is the standard uncertainty (k = 1)."
    )
    ALONE = (
        "The offsets alone hold for an arm whose lengths and twists stay as they are: enter these "
        "in a controller that takes nothing else. The others go with the corrected robot file."
    )
    NOT_TOLD = "Not identified: what it is confounded with stands further below."
    HOLD_OUT = (
        "Fitted on the other poses, means over the splits; every pose counts that was held out, "
        "outlying or not. The criterion is the Bayesian one: a larger model is taken where it "
        "falls by 10 or more."
    )
    JUDGED = "The arm was not identified from these."
    PLACES = (
        "Base and tool are found anew with every model; only changes of the arm's own numbers are "
        "shown. U is the expanded uncertainty (k = 2)."
    )
    GAUGE = (
        "A gauge is told apart by no motion: the others make it up, whatever the arm does. What is "
        "not supported could be told by another motion; what is not called for could be freed, but "
        "the data fit as well without. u: standard uncertainty beside all that is supported."
    )
    INDEXES = (
        "From the singular values of the whitened columns, scaled by 1 mm and 1°: O1 their "
        "geometric mean over √N (Borm and Menq), O2 the smallest over the largest (Driels and "
        "Pathre), O3 the smallest (Nahvi and others), O4 its square over the largest (Nahvi and "
        "Hollerbach), O5 one over the sum of their inverses (Sun and Hollerbach)."
    )
    OUTLYING = (
        "These poses do not belong to the others: noise reaches their distance once in a thousand "
        "recordings. They were left out of the fit, not of the residuals."
    )
    SAME = "No parameter of the arm was changed: the data call for no correction."


FIGURES = {
    "identified_residuals": Said(
        "What is left of each pose: by base and tool alone, and by the identified arm.",
        "Two strips over the poses: position in millimetres, orientation in degrees.",
        "The residuals were not kept.",
    ),
    "identified_changes": Said(
        "Change of each parameter of the arm, with its expanded uncertainty (k = 2).",
        "Points with upright bars, one a parameter: angles in degrees, lengths in millimetres.",
        "No parameter of the arm was changed.",
    ),
    "parameter_correlation": Said(
        "Correlation of the identified parameters; numbers below stand for the names at the left.",
        "A square of coloured cells, one a pair of parameters, from −1 to 1.",
        "There are no correlations to show.",
    ),
}
