"""The command `shipfp`: entry point, exit statuses, and one-line error messages.

Commands import what they need when they run, so that help and usage errors do not wait for SciPy.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import gc
import io
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any


@contextlib.contextmanager
def ends_without_a_word() -> Iterator[None]:
    """Leave Ctrl-C to the system during imports, since an interrupt would print a traceback."""
    heeded = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if not heeded:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


with ends_without_a_word():
    import typer

    from shipfp_rs.cli.budget import budget
    from shipfp_rs.cli.design import design
    from shipfp_rs.cli.export import export
    from shipfp_rs.cli.init import init
    from shipfp_rs.cli.inspect import convert, inspect
    from shipfp_rs.cli.reproduce import compare, reproduce
    from shipfp_rs.cli.run import check, demo, run, simulate
    from shipfp_rs.cli.sweep import sweep
    from shipfp_rs.cli.tune import tune
    from shipfp_rs.cli.view import view
    from shipfp_rs.errors import IdentificationError, InputError, InternalError, ShipfpError, SimulationError

DONE, FAILED, BAD_INPUT, INTERRUPTED, ENDED = 0, 1, 2, 130, 143
NOT_THE_USERS = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EIO)
"""Error numbers of file errors caused by the system's limits and devices; all others concern a name given by the user."""
FULL = (errno.ENOSPC, errno.EROFS, errno.EFBIG, *([errno.EDQUOT] if hasattr(errno, "EDQUOT") else []))
"""Error numbers of a disk that is full or read-only."""
ENDING = (signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else []))
"""Signals by which other processes end a command; SIGHUP means a closed terminal."""
AGAIN_S = 0.2
"""Interval at which an interrupt is raised again [s], since a library may catch and discard it."""
LONGEST_WORD = 300
"""Longest name shown in full, in characters."""
COLLECTED_AFTER = 50_000
"""Threshold of the garbage collector's youngest generation, high since imports create many objects and discard few."""

app = typer.Typer(
    name="shipfp",
    help="Find the dynamic parameters of a ship's propulsion drive train, its fingerprint, from a trial log.",
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
)
EXAMPLES: dict[Callable[..., Any], str] = {
    demo: "shipfp demo --out my-demo",
    run: "shipfp run my-trial/TRIAL.toml --out my-result",
    init: "shipfp init my-trial --log my-log.csv",
    check: "shipfp check my-trial/TRIAL.toml",
    view: "shipfp view my-log.csv",
    inspect: "shipfp inspect my-log.csv my-trial/TRIAL.toml --out pictures",
    simulate: "shipfp simulate stan-tug-1205 --excitation steps --raw --out log.parquet",
    design: "shipfp design stan-tug-1205 --duration 1200 --amplitude 40 --avoid 2.4:2.8",
    sweep: "shipfp sweep SWEEP.toml --out my-sweep",
    convert: "shipfp convert my-log.raw my-log.parquet",
    compare: "shipfp compare before/fingerprint.json after/fingerprint.json --out changes.png",
    budget: "shipfp budget my-result/fingerprint.json --torque 2",
    tune: "shipfp tune my-result/fingerprint.json --recovery 3 --dip 4 --plot gains.png",
    export: "shipfp export my-result/fingerprint.json --to fmu --out tug.fmu",
}
"""Commands in the order of the help, each with an example."""
for command, example in EXAMPLES.items():
    app.command(epilog=f"Example: {example}")(command)
app.add_typer(reproduce, name="reproduce")


def _version(wanted: bool) -> None:
    if wanted:
        from shipfp_rs import __version__

        typer.echo(f"shipfp {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _frame(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


@contextlib.contextmanager
def _orderly_end(asked: list[int]) -> Iterator[None]:
    """Handle SIGTERM and a closed terminal like Ctrl-C, so that temporary files and processes are cleaned up.

    The signals are appended to `asked`.
    """

    def end(number: int, _: object) -> None:
        asked.append(number)
        if hasattr(signal, "setitimer"):  # not on Windows
            before.setdefault(signal.SIGALRM, signal.signal(signal.SIGALRM, again))
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        raise KeyboardInterrupt

    def again(*_: object) -> None:
        if not _is_ending():
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # A shell's background command starts with Ctrl-C ignored, which is kept.
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    # Under nohup the signal of a closed terminal is ignored, which is kept.
    closing = [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, end) for number in (*closing, *[signal.SIGINT] * heeded)}
    hook = sys.unraisablehook

    def swallowed(unraisable: Any) -> None:
        # Python prints an interrupt that is raised in a callback and continues; the timer raises the interrupt again.
        if not (asked and isinstance(unraisable.exc_value, KeyboardInterrupt)):
            hook(unraisable)

    sys.unraisablehook = swallowed
    try:
        yield
    finally:
        sys.unraisablehook = hook
        if asked and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _is_ending() -> bool:
    """Whether an interrupt is propagating; otherwise a library has caught and discarded it."""
    error = sys.exception()
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `shipfp` and return its exit status: 0 success, 2 bad input, 130 interrupted, 143 terminated, 1 any other error.

    Errors are one line on stderr; SHIPFP_TRACEBACK=1 adds the traceback.
    """
    asked: list[int] = []
    try:
        _open_closed_streams()
        gc.set_threshold(COLLECTED_AFTER)  # rare, and none at exit, when the process frees all memory
        atexit.register(gc.freeze)
        _take_odd_words_from_the_environment()
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper):
                # A terminal without Greek letters must not cause an error.
                stream.reconfigure(errors="backslashreplace")
        status = _status(arguments, asked)
    except KeyboardInterrupt:  # interrupted before the command started, or after it ended
        status = INTERRUPTED
    if status == INTERRUPTED:
        # If an interrupt is raised during `exec` of a string, as in dataclasses, CPython ends with an error at exit, even
        # if the interrupt is caught, unless another string is executed.
        exec("")
        ended = not set(asked).isdisjoint(ENDING)
        _line("ended from outside" if ended else "interrupted")
        return ENDED if ended else INTERRUPTED
    return status


def _open_closed_streams() -> None:
    """Open the null device for closed standard streams; else a file may get a stream's descriptor, and so its output."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: PTH123, SIM115


def _take_odd_words_from_the_environment() -> None:
    """Override values of environment variables that break libraries: thread counts, and Matplotlib's backend."""
    os.environ["MPLBACKEND"] = "agg"
    first, *others = os.environ.get("OMP_NUM_THREADS", "1").split(",")
    if others or not first.strip().isdecimal():
        os.environ["OMP_NUM_THREADS"] = first if first.strip().isdecimal() else "1"


def _status(arguments: Sequence[str] | None, asked: list[int]) -> int:
    """Run the command and return its status; every exception becomes a message and a status."""
    with warnings.catch_warnings(), _orderly_end(asked):
        warnings.showwarning = _show_warning
        try:
            status = app(arguments, prog_name="shipfp", standalone_mode=False)
            sys.stdout.flush()
        except (BrokenPipeError, SystemExit):  # the reader has closed the pipe; click raises SystemExit
            _leave_output()
            return DONE
        except (KeyboardInterrupt, typer.Abort):
            return INTERRUPTED
        except BaseException as error:  # last resort: no traceback reaches the user
            # A library may turn an interrupt into a different error: of Python or pydantic while a class is created, or a
            # panic of Rust code.
            if asked:
                return INTERRUPTED
            if not isinstance(error, Exception):
                raise
            return _fail(error)
    return status or DONE


def _fail(error: Exception) -> int:
    if os.environ.get("SHIPFP_TRACEBACK"):
        traceback.print_exception(error)
    # Usage errors are exceptions of click or, in newer versions, of typer; both have `format_message`.
    usage = getattr(error, "format_message", None)
    if usage is not None:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "shipfp"
        _line(f"error: {usage().rstrip('.') or 'no command given, expected one'}; see {command} --help")
        return BAD_INPUT
    if isinstance(error, ShipfpError) and not isinstance(error, InternalError):
        _line(f"error: {error}")
        # A fit or simulation that fails because of data or sizes counts as bad input.
        if isinstance(error, InputError | IdentificationError | SimulationError):
            return BAD_INPUT
    elif isinstance(error, OSError):
        _line(
            f"error: {error.filename or 'a file or the output'}: {error.strerror or error}; {_advice(error.errno)}"
        )
        _leave_output()
        return FAILED if error.errno in NOT_THE_USERS else BAD_INPUT
    elif isinstance(error, MemoryError):
        _line("error: out of memory; use a shorter window or a lower sample rate")
    else:
        _line(
            f"internal error: {type(error).__name__}: {error}; run with SHIPFP_TRACEBACK=1 for the traceback"
        )
    return FAILED


def _advice(number: int | None) -> str:
    if number in (errno.EACCES, errno.EPERM):
        return "give yourself the right to it, or choose another name"
    if number in FULL:
        return "choose another disk"
    return "check its name"


def _leave_output() -> None:
    """Keep the interpreter from flushing again into a closed pipe or onto a full disk."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _line(text: str) -> None:
    words = (word if len(word) <= LONGEST_WORD else f"{word[:60]}...{word[-20:]}" for word in text.split())
    print("shipfp:", *words, file=sys.stderr)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    _line(f"warning: {message}")
