"""The command line: `verify COMMAND …`. Known errors take one line, unknown ones a traceback."""

import atexit
import errno
import os
import re
import signal
import sys
import traceback

import typer

# matrices here are small: a second BLAS thread costs more than it brings, and takes the core
# that decodes; numpy reads this when it is first imported, which the commands do later
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# else numexpr, which pandas loads, takes OMP_NUM_THREADS for one number, of a few threads
os.environ["NUMEXPR_NUM_THREADS"] = os.environ.get("NUMEXPR_NUM_THREADS") or "1"

from verify.cli.batch import batch
from verify.cli.board import board
from verify.cli.calibrate.calibrate import calibrate
from verify.cli.convert.convert import convert
from verify.cli.doctor.doctor import doctor
from verify.cli.emulate import emulate
from verify.cli.grab.grab import grab
from verify.cli.identify.identify import identify
from verify.cli.options import Command
from verify.cli.plan.plan import plan
from verify.cli.report import report
from verify.cli.robots import robots
from verify.cli.run import demo, record, run
from verify.cli.simulate import simulate
from verify.cli.terminal import hangups, show_log, terminal
from verify.errors import InputError, WatchDefectError, one_line

# typer brings its own copy of click or uses the installed one, depending on its version; either
# way what it raises on wrong usage is the base of its BadParameter
WrongUsage: type[Exception] = next(
    c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException"
)
BAD_INPUT = 2
INTERRUPTED = 130
DEFECT = 70  # EX_SOFTWARE of sysexits.h
REFUSALS = (errno.ENOSPC, errno.EACCES, errno.EROFS, errno.EDQUOT)  # of the system: no defects

ENVIRONMENT = {  # variables that libraries read when they are loaded: form, what is expected
    "OMP_NUM_THREADS": (r" *0*[1-9]\d* *(, *0*[1-9]\d* *)*", "numbers of threads: 4 or 4,2"),
    "SOURCE_DATE_EPOCH": (r"\d{1,11}", "whole seconds since 1970"),
}
REPEAT_TIME = 0.5  # s: an interruption that has not ended the command by then was swallowed

GLOBAL_OPTIONS_HELP = (
    "With every command: --quiet, --verbose, --json (one object per line on standard output), "
    "--open (the report, in a browser), --version."
)
app = typer.Typer(
    name="verify",
    help="Is my robot where it says it is? Two cameras and a few LEDs check an arm's encoders.",
    epilog=GLOBAL_OPTIONS_HELP,
    pretty_exceptions_enable=False,  # an unknown error shows Python's own traceback
    rich_markup_mode=None,
)
COMMANDS = (
    run, record, batch, identify, plan, grab, report, convert, board, simulate, robots, emulate,
    doctor, demo,
)  # fmt: skip
for command in COMMANDS:
    app.command(cls=Command, epilog=GLOBAL_OPTIONS_HELP)(command)
app.add_typer(calibrate, name="calibrate", epilog=GLOBAL_OPTIONS_HELP)


@app.callback()
def _verify() -> None:
    """Is my robot where it says it is? Two cameras and a few LEDs check an arm's encoders."""
    for name, (form, expected) in ENVIRONMENT.items():
        value = os.environ.get(name, "")
        if not value:  # an empty one counts as none
            os.environ.pop(name, None)
        elif not re.fullmatch(form, value, re.ASCII):
            remedy = "Correct or unset this environment variable."
            raise InputError(name, f'is "{value}"', f"expected: {expected}", remedy)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with docs/results.md's status."""
    words = _global_flags(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    show_log()
    sys.unraisablehook = _show_unraisable
    for number in (signal.SIGTERM, *hangups()):  # they leave nothing half-written either
        signal.signal(number, _interrupt)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, _interrupt)
    atexit.register(_ignore_interruptions)
    sys.exit(_status(words))


class CommandInterrupt(KeyboardInterrupt):
    """Ctrl-C, SIGTERM, SIGHUP; a class of its own: for it Python does not end by a signal."""


def _ignore_interruptions() -> None:
    """Ignore signals by which Python's own end, which restores their actions, would be killed."""
    for name in ("SIGALRM", "SIGHUP", "SIGINT", "SIGTERM"):
        if hasattr(signal, name):  # the first two are not everywhere
            signal.signal(getattr(signal, name), signal.SIG_IGN)


def _interrupt(_signal: int, _frame: object) -> None:
    """Interrupt; again and again, as a library's callback may swallow the exception."""
    signal.signal(signal.SIGALRM, _interrupt_again)
    signal.setitimer(signal.ITIMER_REAL, REPEAT_TIME, REPEAT_TIME)
    raise CommandInterrupt


def _show_unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """Show what a callback cannot raise, but for an interruption: that comes again."""
    if not isinstance(unraisable.exc_value, CommandInterrupt):
        sys.__unraisablehook__(unraisable)


def _interrupt_again(_signal: int, _frame: object) -> None:
    """Interrupt unless that is what the program is ending by: what it cleans up is not cut off."""
    ending = sys.exception()
    while ending is not None:
        if isinstance(ending, KeyboardInterrupt):
            return
        ending = ending.__context__
    raise CommandInterrupt


def _status(words: list[str]) -> int:
    try:
        outcome = typer.main.get_command(app)(words, prog_name="verify", standalone_mode=False)
    except InputError as problem:
        return _refuse(str(problem))
    except WatchDefectError as problem:
        sys.stderr.write(f"error: {one_line(str(problem))}\n")
        return DEFECT
    except WrongUsage as problem:
        text = str(getattr(problem, "format_message", problem.__str__)())
        return _refuse(f"{text}{'' if text[-1:] in '.?!' else '.'} See `verify --help`.")
    except (KeyboardInterrupt, typer.Abort):  # older typer; newer ones give back the status
        outcome = INTERRUPTED
    except Exception as problem:
        from verify.io.files import lacks_memory, memory_refusal, system_refusal

        if lacks_memory(problem):
            return _refuse(str(memory_refusal("memory")))
        if isinstance(problem, OSError) and problem.errno in REFUSALS:
            return _refuse(str(system_refusal(problem.filename or "output", problem)))
        traceback.print_exc()
        return DEFECT  # must not pass for "does not conform", which is 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)  # it does end
    if outcome == INTERRUPTED:
        sys.stderr.write("interrupted\n")
    return outcome if isinstance(outcome, int) else 0


def _refuse(message: str) -> int:
    sys.stderr.write(f"error: {one_line(message)}\n")
    return BAD_INPUT


def _global_flags(words: list[str]) -> list[str]:
    """Take the flags that work everywhere out of the command line."""
    end = words.index("--") if "--" in words else len(words)
    flags, rest = words[:end], words[end:]
    if "--version" in flags:
        from verify.core.version import __version__

        sys.stdout.write(f"verify {__version__}\n")
        sys.exit(0)
    terminal.quiet = "--quiet" in flags
    terminal.verbose = "--verbose" in flags
    terminal.as_json = "--json" in flags
    terminal.opens = "--open" in flags
    taken = {"--quiet", "--verbose", "--json", "--open"}
    return [w for w in flags if w not in taken] + rest
