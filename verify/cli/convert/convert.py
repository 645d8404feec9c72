"""Read recordings of other programs into a session, and write sessions and results for others."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from verify.cli.options import ReplaceInFolder, refuse_options
from verify.cli.terminal import terminal

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from verify.io.export.content import ExportContent

FILES = ("mat", "mcap", "rrd")


ExportFormat = StrEnum("ExportFormat", "tum csv parquet mat mcap rrd")  # of another program
StampKind = StrEnum("StampKind", "header received")  # which time of a message counts
AngleUnit = StrEnum("AngleUnit", "deg rad")
LengthUnit = StrEnum("LengthUnit", "mm m um")
PoseFrame = StrEnum("PoseFrame", "instrument robot_base")  # what poses are in


def convert(
    sources: Annotated[
        list[Path],
        Argument(
            help="A bag, an MCAP file, or tables (CSV): into a session. A session's or a "
            "report's folder: out of it."
        ),
    ],
    out: Annotated[
        Path | None,
        Option("-o", "--out", help="Folder or file of the result; else the last argument."),
    ] = None,
    to: Annotated[
        ExportFormat | None, Option(help="Format of an export; else by the ending of -o.")
    ] = None,
    robot: Annotated[str | None, Option(help="The robot: a name, or a robot file or URDF.")] = None,
    left: Annotated[str | None, Option(help="Bag: topic of the left camera.")] = None,
    right: Annotated[str | None, Option(help="Bag: topic of the right camera.")] = None,
    joints: Annotated[str | None, Option(help="Bag: topic of the joint readings.")] = None,
    joint_names: Annotated[
        str | None, Option(help="The recording's names of the joints, in the robot's order: A,B,…")
    ] = None,
    stamps: Annotated[
        StampKind, Option(help="Bag: times of the headers, or of the recording.")
    ] = StampKind.header,
    rig: Annotated[
        Path | None, Option(help="Bag: rig.toml of the cameras; else from CameraInfo.")
    ] = None,
    marker: Annotated[
        Path | None, Option(help="Bag: marker.toml, where the LEDs are known.")
    ] = None,
    angles: Annotated[AngleUnit | None, Option(help="Unit of the angles.")] = None,
    lengths: Annotated[LengthUnit | None, Option(help="Table: unit of the lengths.")] = None,
    rotation: Annotated[
        str | None,
        Option(help="Table: rotvec, quaternion, or axes of Euler angles: xyz fixed, ZYX moving."),
    ] = None,
    instrument: Annotated[
        str | None, Option(help="Table: the instrument that measured its poses; never the robot.")
    ] = None,
    frame: Annotated[
        PoseFrame, Option(help="Table: the frame of its poses.")
    ] = PoseFrame.instrument,
    mapping: Annotated[
        list[str] | None,
        Option(
            "--map",
            help="Table: TARGET=COLUMN:UNIT in place of the proposal; commas between, or repeated.",
        ),
    ] = None,
    yes: Annotated[bool, Option("--yes", help="Table: the proposed mapping is correct.")] = False,
    force: ReplaceInFolder = False,
) -> None:
    """Bags, MCAP and tables into a session; results to others.

    A table's columns are proposed from its header and shown. A terminal asks whether they are
    correct; elsewhere --yes or --map is needed.

    Example: verify convert sample_sessions/multi_joint_fault_6r -o fault.mcap
    """
    from verify.cli.convert.imports import ImportOptions, convert_bag, convert_tables
    from verify.errors import InputError
    from verify.io.bags.bag import is_bag
    from verify.io.export.content import is_exportable
    from verify.io.files import refused_as_input_error

    if out is None:
        if len(sources) == 1:
            expected = "a folder or file of the result is expected"
            raise InputError(sources[0], "stands alone", expected, "Add its name, or -o OUT.")
        *sources, out = sources
    first = sources[0]
    with refused_as_input_error(first):
        bag = is_bag(first)
        exports = first.is_dir() and not bag
    for_bags = {
        "--left": left, "--right": right, "--joints": joints, "--rig": rig, "--marker": marker,
        "--stamps": stamps is StampKind.received,
    }  # fmt: skip
    for_tables = {
        "--lengths": lengths, "--rotation": rotation, "--instrument": instrument,
        "--map": mapping, "--yes": yes, "--frame": frame is PoseFrame.robot_base,
    }  # fmt: skip
    for_both = {"--robot": robot, "--joint-names": joint_names, "--angles": angles}
    useless = for_bags | for_tables | for_both if exports else for_tables if bag else for_bags
    refuse_options(
        {name: bool(given) for name, given in useless.items()},
        f"does nothing with {first}", "it is for another kind of source", "Leave it out.",
    )  # fmt: skip
    if (bag or exports) and len(sources) > 1:
        raise InputError(sources[1], "is given too", "one bag or folder is converted at once",
                         "Several tables go together.")  # fmt: skip
    if exports:
        if not is_exportable(first):
            expected = "a session, a report of `verify run` or a ROS 2 bag is expected"
            remedy = "Give a folder with session.toml, results or metadata.yaml."
            raise InputError(first, "is a folder of another kind", expected, remedy)
        _convert_out(first, out, None if to is None else to.value, force=force)
        return
    if to is not None:
        expected = "it is for sessions and reports"
        raise InputError("--to", f"{first} becomes a session", expected, "Leave it out.")
    options = ImportOptions(
        robot=robot,
        joint_names=tuple(n.strip() for n in joint_names.split(",")) if joint_names else (),
        topics=(left, right, joints),
        stamps=stamps.value,
        rig=rig,
        marker=marker,
        angles="" if angles is None else angles.value,
        lengths="" if lengths is None else lengths.value,
        rotation=rotation or "",
        instrument=instrument,
        frame=frame.value,
        mapping=tuple(mapping or ()),
        yes=yes,
    )
    (convert_bag if bag else convert_tables)(sources, out, options, force=force)


def _convert_out(source: Path, out: Path, to: str | None, *, force: bool) -> None:
    """Write what a folder holds in a format, by its name or by the ending of `out`.

    Raises:
        InputError: the folder is damaged, lacks what the format shows, or `out` cannot be written.
    """
    from verify.errors import InputError
    from verify.io.export.content import FOLDERS, read_content, require_poses
    from verify.io.files import require_apart, write_file_whole, write_folder_whole
    from verify.io.results import refuse_file

    kind = to or out.suffix.removeprefix(".")
    if kind not in (*FOLDERS, *FILES):
        expected = f"--to is one of {', '.join((*FOLDERS, *FILES))}"
        remedy = "Give --to, or let -o end with .mat, .mcap or .rrd."
        raise InputError("-o", f"{out} does not say the format", expected, remedy)
    require_apart(out, source)
    if kind in FILES:
        refuse_file(out, force=force)
    content = read_content(source)
    if kind in ("tum", "mcap", "rrd"):  # what shows readings and pictures on one clock
        terminal.warn(*content.notes)
    if kind == "tum":
        require_poses(content, source)
    if kind in FOLDERS:
        with write_folder_whole(out, force) as folder:
            FOLDERS[kind](content, folder)
            written = sorted(path.name for path in folder.iterdir())
    else:
        with write_file_whole(out) as path:
            _write_file(content, kind, path)
        written = [out.name]
    terminal.say(f"{out}: {', '.join(written)}")
    terminal.record("result", out=str(out), format=kind, files=written)


def _write_file(content: "ExportContent", kind: str, path: Path) -> None:
    if kind == "mat":
        from verify.io.export.content import write_mat

        write_mat(content, path)
        return
    if kind == "mcap":
        from verify.io.export.mcap import write_mcap as write
    else:
        from verify.io.export.rrd import write_rrd as write
    with terminal.progress("messages") as progress:
        write(content, path, progress)
