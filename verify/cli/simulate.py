"""Make a session with known truth and chosen faults, or board pictures for a calibration."""

from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from verify.cli.options import ReplaceInFolder
from verify.cli.terminal import terminal


def simulate(
    scenario: Annotated[
        str, Argument(help="A scenario file (TOML), or the name of a built-in scenario.")
    ],
    out: Annotated[Path, Option("-o", "--out", help="Folder of the result.")],
    seed: Annotated[int | None, Option(min=0, help="Seed; default: the scenario's own.")] = None,
    force: ReplaceInFolder = False,
) -> None:
    """Make a session with known truth and faults, or board pictures.

    Example: verify simulate multi_joint_fault_6r -o my_session
    """
    import msgspec

    from robots import RobotError
    from verify.errors import InputError
    from verify.io.files import restated, write_folder_whole
    from verify.simulation import library
    from verify.simulation.boards import files
    from verify.simulation.boards import simulate as boards_simulate
    from verify.simulation.scenario import BoardScenario
    from verify.simulation.session import folder
    from verify.simulation.session import simulate as session_simulate

    chosen = library.load(scenario)
    if seed is not None:
        chosen = msgspec.structs.replace(chosen, seed=seed)
    with write_folder_whole(out, force) as place:
        with restated(RobotError, f"{scenario}, robot: "), restated(InputError, f"{scenario}, "):
            if isinstance(chosen, BoardScenario):
                made = boards_simulate.simulate_boards(chosen)
                pairs, write = len(made), partial(files.write, made, place)
                other, pictures = "session.toml", pairs
            else:
                session = session_simulate.simulate_session(chosen)
                pairs, write = len(session), partial(folder.write_session, session, place)
                other, pictures = "board.toml", pairs * (chosen.recording.format == "png")
        folder.refuse_remains(out, other, pictures)
        with terminal.progress("pictures") as progress:
            number = count(1)
            write(lambda: progress(next(number), 2 * pairs))
    terminal.say(f"{pairs} pairs in {out}")
    terminal.record("result", out=str(out), pairs=pairs)
