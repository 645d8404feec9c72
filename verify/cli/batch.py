"""Measure every session under some folders: tables, and a report on the fleet."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from verify.cli import options as option
from verify.cli.terminal import report_files, terminal
from verify.errors import InputError

if TYPE_CHECKING:  # imported when the command runs: `--help` answers at once
    from reports import Results
    from verify.fleet.batch.run import BatchProgress, BatchResult, ProgressCallback, WorkerPool
    from verify.fleet.trends.assess import TrendRequest

EXIT_SOME_FAILED = 4


def batch(
    folders: Annotated[
        list[str], Argument(help="Folders with sessions in them, or URLs such as s3://….")
    ],
    out: Annotated[
        Path,
        Option(
            "-o", "--out", help="Folder of the results; sessions measured there before are skipped."
        ),
    ] = Path("fleet-report"),
    tolerance: option.JointTolerance = None,
    position_tolerance: option.PositionTolerance = None,
    orientation_tolerance: option.OrientationTolerance = None,
    workers: Annotated[
        int | None, Option(min=1, help="Processes on this machine; default: one per processor.")
    ] = None,
    scheduler: Annotated[
        str | None, Option(help="Address of a Dask scheduler whose cluster measures the sessions.")
    ] = None,
    reports: Annotated[
        bool, Option("--reports", help="Write each session's own report as well.")
    ] = False,
    by: Annotated[
        str, Option(help="How arms are distinguished: by robot, or by robot and folder.")
    ] = "robot",
    since: Annotated[str | None, Option(help="Compare before and after a day: 2026-06-15.")] = None,
    compare: Annotated[
        tuple[str, str] | None, Option(help="Compare the sessions below two folders.")
    ] = None,
) -> int:
    """Check every session under some folders; one report on all.

    Exit status 0: all ran, all conform where a verdict was asked for; 1: some do not conform; 2:
    none could be measured; 3: some are undecided; 4: some failed, none of the others is 1 or 3.

    Example: verify batch sample_sessions -o fleet-report
    """
    from verify.core.version import __version__
    from verify.fleet.batch.finding import find_sessions
    from verify.fleet.batch.records import BatchOptions
    from verify.fleet.batch.run import measure_all, report_all
    from verify.fleet.batch.store import require_writable
    from verify.fleet.batch.tasks import require_joints
    from verify.fleet.trends.assess import require_folders
    from verify.io.results import refuse_session

    tolerances = option.ToleranceOptions(tolerance, position_tolerance, orientation_tolerance)
    tolerances.checked_angles()
    request = _trend_request(by, since, compare)
    refuse_session(out)
    with closing(_worker_pool(workers, scheduler)) as pool:  # its workers load meanwhile
        found, failures = find_sessions(folders, out)
        require_folders([one.session for one in found], request)
        require_joints(found, tolerances)
        require_writable(out)
        options = BatchOptions(tolerances, __version__)
        with _show_progress() as watch:
            done = measure_all(found, failures, out, options, pool, watch)
    if reports:
        with closing(_worker_pool(workers, None)) as pool, terminal.progress("reports") as counter:
            report_all(done, pool, counter)
    return _finish(done, out, request)


def _trend_request(by: str, since: str | None, compare: tuple[str, str] | None) -> "TrendRequest":
    from datetime import date

    from verify.fleet.trends.assess import ARM_GROUPINGS, TrendRequest

    if by not in ARM_GROUPINGS:
        raise InputError("--by", f'"{by}" was given', f"{' or '.join(ARM_GROUPINGS)} is expected")
    try:
        day = None if since is None else date.fromisoformat(since)
    except ValueError:
        raise InputError(
            "--since", f'"{since}" is no day', "year, month and day are expected",
            "Example: 2026-06-15",
        ) from None  # fmt: skip
    return TrendRequest(by, day, compare)


def _worker_pool(workers: int | None, scheduler: str | None) -> "WorkerPool":
    from verify.fleet.batch.cluster import Cluster
    from verify.fleet.batch.workers import ProcessPool, available_cpus

    if scheduler is None:
        return ProcessPool(workers or available_cpus())
    if workers is not None:
        raise InputError("--workers", "was given with --scheduler", "a cluster has its own workers")
    cluster = Cluster(scheduler)
    if cluster.page is not None:
        terminal.say(f"Dask dashboard: {cluster.page}")
    return cluster


@contextmanager
def _show_progress() -> "Iterator[ProgressCallback]":
    """Show a batch's progress; name at once each session that failed or is measured again."""
    failures = again = 0
    with terminal.progress("sessions") as counter:

        def show(progress: "BatchProgress") -> None:
            nonlocal failures, again
            terminal.warn(*(f"failed: {failure.why}" for failure in progress.failures[failures:]))
            terminal.say(*(f"Again: {line}" for line in progress.again[again:]))
            failures, again = len(progress.failures), len(progress.again)
            rate, left = progress.pairs_a_second, progress.time_left
            counter(progress.done, progress.sessions, _note(progress, rate, left))
            terminal.record(
                "progress",
                sessions=progress.sessions,
                done=progress.done,
                kept=progress.kept,
                failures=failures,
                pairs_per_s=rate,
                time_left_s=left,
            )

        yield show


def _note(progress: "BatchProgress", rate: float | None, left: float | None) -> str:
    parts = [] if rate is None else [f"{rate:.1f} pairs/s"]
    if left is not None and progress.done < progress.sessions:
        parts.append(f"{left / 60:.0f} min left" if left >= 90 else f"{left:.0f} s left")
    if progress.failures:
        parts.append(f"{len(progress.failures)} failed")
    return ", ".join(parts)


def _finish(done: "BatchResult", out: Path, request: "TrendRequest") -> int:
    """Write the tables and the fleet report; tell how it ended."""
    import reports
    from verify.fleet.batch import tables
    from verify.fleet.trends.assess import assess
    from verify.io.files import write_folder_whole
    from verify.io.results import RESULTS, write_reports

    with write_folder_whole(out, force=True) as folder:
        if not done.kept:
            tables.write_failures(folder, done.failures)
        else:
            tables.write(folder, done.kept, done.failures)
            sessions = tables.read_flat_columns(folder / "sessions.parquet")
            failures = tables.failure_table(done.failures)
            reported = [s for s, place in done.kept if (place / "report.html").exists()]
            results = assess(sessions, failures, request, reported)
            reports.write(results, folder / RESULTS)
            write_reports(results, folder, "fleet")
    if not done.kept:
        found = f"none of its {len(done.failures)} sessions could be measured"
        raise InputError(out / "failures.csv", found, "", "It gives the reason of each session.")
    verdicts = set(sessions["verdict"].dropna())
    _print_summary(done, out, results)
    if "nonconform" in verdicts:
        return 1
    if "undecided" in verdicts:
        return 3
    return EXIT_SOME_FAILED if done.failed else 0


def _print_summary(done: "BatchResult", out: Path, results: "Results") -> None:
    from reports.fleet.certificate import nonconforming_sessions, several_arms

    progress, copies = done.progress, len(done.failures) - len(done.failed)
    not_counted = f"; {copies} not counted: the same recording as another" if copies else ""
    terminal.warn(*(one.why for one in done.failures if one not in done.failed))
    terminal.warn(*several_arms(results))
    counted = "1 session" if progress.measured == 1 else f"{progress.measured} sessions"
    terminal.say(
        f"{counted} measured, {progress.kept} kept from before, "
        f"{len(done.failed)} failed{not_counted}"
    )
    terminal.say(*(f"  does not conform: {line}" for line in nonconforming_sessions(results)))
    terminal.say(f"Report: {report_files(out, 'fleet')}")
    terminal.record("result", out=str(out), summary=results.summary)
