"""`shipfp view`: view a log in the browser, mark windows, write TRIAL.toml, run it, read reports."""

from __future__ import annotations

import contextlib
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from shipfp_rs.cli.options import Rate, file_argument, print_text
from shipfp_rs.errors import InputError


def view(
    path: Annotated[Path, file_argument("LOG|TRIAL.toml|DIR", "What to look at.")] = Path(),
    rate_hz: Rate = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address and open nothing.")
    ] = False,
) -> None:
    """Look through a log in the browser, mark windows, write TRIAL.toml, run it and read the report.

    This command serves the page, on this machine only, until Ctrl-C. It keeps a file NAME.shipfp-pyramid in the log's
    folder, so that the log opens at once the next time; that file may be deleted.
    """
    from shipfp_rs.logs.log import Log
    from shipfp_rs.view.desk import Desk
    from shipfp_rs.view.pyramid import stored
    from shipfp_rs.view.server import end_asked_for, handed_over, serving

    if not path.exists():
        raise InputError(f"{path}: no such file or folder; give a log, a TRIAL.toml or a folder")
    if not path.is_dir() and not path.is_file():
        raise InputError(f"{path}: a pipe or a device, expected a log, a TRIAL.toml or a folder")
    desk = Desk(path if path.is_dir() else path.parent)
    page = "folder.html"
    if path.suffix == ".toml" and path.is_file():
        page = f"look.html?doc={desk.open_trial(path)[0]}"
    elif path.is_file():
        number = desk.open_log(path, rate_hz)
        rate_hz = desk.document(number).rate_hz
        if stored(path, rate_hz) is None:
            Log.open(path, rate_hz=rate_hz)  # an unreadable file is reported here, not in the page
        page = f"look.html?doc={number}"
    # Done before the address is printed, since a program that reads the address may end the command at once.
    ended = end_asked_for()
    with serving(desk, page) as server, contextlib.ExitStack() as shown:
        print_text(f"{path}: {server.address}", "Ctrl-C ends it.")
        if not no_browser:
            webbrowser.open(shown.enter_context(handed_over(server.address, desk.folder)))
        while not ended.wait(0.5):
            pass
