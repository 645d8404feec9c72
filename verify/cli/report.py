"""Build the reports again from results on disk, as the user wants them to look."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from verify.cli.terminal import report_files, terminal


def report(
    out: Annotated[Path, Argument(help="What `verify run`, `calibrate`, `batch` or `grab` wrote.")],
    logo: Annotated[Path | None, Option(help="A PNG or SVG for the top of the report.")] = None,
    owner: Annotated[
        str | None, Option(help="A line for the top of the report: whose it is.")
    ] = None,
    template: Annotated[
        Path | None,
        Option(help="A folder with report.html.j2, report.css or report.typ of your own."),
    ] = None,
) -> int:
    """Write a report again from its results, in a look of your own.

    Example: verify report multi_joint_fault_6r-report --logo lab.svg
    """
    import reports
    from reports.results import rebuild_command
    from verify.errors import InputError
    from verify.io.files import restated, write_whole
    from verify.io.results import RESULTS, read_results

    results = read_results(out)
    try:
        with restated(reports.ReportError):
            look = reports.look(logo=logo, owner=owner, templates=template)
            page, pages = reports.render_report(results, look)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as problem:
        # whole files whose hashes fit, but not what a report of this kind is made of
        found = f"cannot be made into a report ({type(problem).__name__}: {problem})"
        remedy = rebuild_command(out / RESULTS)
        expected = "results as this version writes them are expected"
        raise InputError(out / RESULTS, found, expected, remedy) from problem
    name = "fleet" if results.summary.get("kind") == "fleet" else "report"
    write_whole(out / f"{name}.html", page.encode())
    write_whole(out / f"{name}.pdf", pages)
    terminal.say(f"Report: {report_files(out, name)}")
    terminal.record("result", out=str(out))
    return 0
