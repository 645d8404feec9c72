"""Identify an arm's own parameters from sessions."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from verify.cli.options import ReplaceFiles

ModelChoice = StrEnum("ModelChoice", "auto offsets geometry")  # how much of the arm is freed
PlacementChoice = StrEnum("PlacementChoice", "auto free held")  # of a base or an LED body


def identify(
    sessions: Annotated[list[Path], Argument(help="Session folders, all of one arm.")],
    out: Annotated[
        Path | None, Option("-o", "--out", help="Where the results go; NAME-identification.")
    ] = None,
    model: Annotated[
        ModelChoice, Option(help="What is fitted; auto: offsets or geometry, as the data require.")
    ] = ModelChoice.auto,
    base: Annotated[
        PlacementChoice,
        Option(help="The robot's pose; auto: fitted if it was found through the encoders."),
    ] = PlacementChoice.auto,
    leds: Annotated[
        PlacementChoice, Option(help="The LEDs' pose on the flange; likewise.")
    ] = PlacementChoice.auto,
    splits: Annotated[int, Option(min=1, max=100, help="Random splits of the hold-out.")] = 10,
    share: Annotated[
        float, Option(min=0.05, max=0.9, help="Share of the poses held out in each.")
    ] = 0.3,
    judge: Annotated[
        list[Path] | None,
        Option(help="A session to check the result with, not used in the fit; repeatable."),
    ] = None,
    force: ReplaceFiles = False,
) -> None:
    """Identify offsets, lengths and twists; write the corrected arm.

    Says which parameters the sessions support, how sure they are, and what each of the others is
    confounded with; judged on poses that were held out.

    Example: verify identify monday tuesday -o arm_identified
    """
    from verify.calibration.kinematics.identify import IdentificationOptions
    from verify.cli.identify.sessions import identify_sessions

    def free(place: PlacementChoice) -> bool | None:
        return None if place is PlacementChoice.auto else place is PlacementChoice.free

    level = None if model is ModelChoice.auto else model.value
    options = IdentificationOptions(level=level, splits=splits, share=share)
    identify_sessions(
        sessions, out, options, free(base), free(leds), judges=judge or (), force=force
    )
