"""Options that several commands share, worded once."""

from typing import Annotated

import typer

JointTolerance = Annotated[
    str | None,
    typer.Option(
        "--tolerance",
        help="Joint errors allowed, degrees: one number, or one a joint: 0.2,0.2,…",
    ),
]
PositionTolerance = Annotated[
    float | None, typer.Option("--position-tolerance", help="Position error allowed, mm.")
]
OrientationTolerance = Annotated[
    float | None,
    typer.Option("--orientation-tolerance", help="Orientation error allowed, degrees."),
]
PagePort = Annotated[
    int, typer.Option(min=0, max=65535, help="The page's port; 0: any that is free.")
]
PageAddress = Annotated[
    str, typer.Option(help="The page's address; another one than this needs a token.")
]
PageToken = Annotated[
    str | None, typer.Option(help="What viewers must show; 16 characters or more.")
]
