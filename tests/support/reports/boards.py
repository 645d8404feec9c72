"""Results of calibrations from boards."""

from dataclasses import replace

from reports.results import Results
from tests.support.reports import calibration as made
from verify.calibration.origin import ResultsOrigin
from verify.calibration.quality.results import calibration_results


def good() -> Results:
    """Everything covered; the cameras turned on their bases."""
    found = made.calibration(count=24)
    return calibration_results(
        replace(found, turning=True), picture=made.pictures(found), origin=ResultsOrigin("boards")
    )


def doubtful() -> Results:
    """Few boards, flat ones, one view that stands out, and inputs to list."""
    found = made.with_poor_view(made.calibration(count=9, tilt_deg=8.0))
    return calibration_results(
        found, origin=ResultsOrigin("boards", inputs=made.INPUTS, warnings=("frames.csv: no pan.",))
    )
