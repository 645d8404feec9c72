"""Build the reports again from results on disk."""

from pathlib import Path
from typing import Annotated

import typer

from verify.terminal import terminal


def report(
    out: Annotated[Path, typer.Argument(help="A folder that `verify run` or `verify calibrate` wrote.")],
) -> int:
    """Build report.html and report.pdf again from the results on disk.

    Example: verify report multi_joint_fault_6r-report
    """
    import reports
    from verify.results_folder import read_results
    from verify.writing import write_whole

    results = read_results(out)
    write_whole(out / "report.html", reports.render_html(results).encode())
    write_whole(out / "report.pdf", reports.render_pdf(results))
    terminal.say(f"Report: {out / 'report.html'} and {out / 'report.pdf'}")
    terminal.record({"type": "result", "out": str(out)})
    return 0
