"""Answers to a page's requests: documents of one folder, their tiles, drafts of trials, jobs and results."""

from __future__ import annotations

import contextlib
import itertools
import json
import re
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from shipfp_rs.errors import InputError
from shipfp_rs.logs.log import suffixes
from shipfp_rs.processing.trial import KINDS as WINDOW_KINDS
from shipfp_rs.processing.trial import Header, Trial
from shipfp_rs.report.markup import KINDS
from shipfp_rs.support.files import read_text, write_text_atomically
from shipfp_rs.support.threads import side_by_side
from shipfp_rs.support.toml import built_in, read_tables, validated
from shipfp_rs.support.units import TO_RPM
from shipfp_rs.vessel.vessel import Vessel
from shipfp_rs.view import draft as drafts
from shipfp_rs.view.document import Document
from shipfp_rs.view.draft import Draft
from shipfp_rs.view.jobs import Jobs
from shipfp_rs.view.results import Results

NAME = re.compile(r"[^/\\\0:.][^/\\\0:]{0,99}\.toml")
"""Permitted file names: those of TOML files, without a folder."""
NO_VESSEL = Header.model_fields["vessel"].default
"""The ship of a trial without a vessel."""
MOST_TILES = 256
MOST_ENTRIES = 500
LARGEST_TOML = 1 << 20
UNREADABLE = (InputError, OSError, ValueError, RuntimeError)
"""Errors by which a file is skipped, so that one invalid file does not hide the folder's other files; RuntimeError:
circular links.
"""

Asked = Mapping[str, str]


class Desk:
    """The viewed folder and its open documents; the desk writes to no other folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.jobs = Jobs()
        self.results = Results(self.folder)
        self._lock = threading.Lock()
        self._saving = threading.Lock()
        self._documents: dict[tuple[Path, Path | None], int] = {}
        self._open: list[Document] = []
        self.asked: dict[str, Callable[[Asked], Any]] = {
            "folder": self._folder,
            "document": lambda asked: self._document(asked).facts(),
            "faults": self._faults,
            "windows": lambda asked: self._document(asked).told_windows(
                _text(asked, "driver"), asked.get("load") or None
            ),
            "within": self._within,
            "mean": lambda asked: self._document(asked).mean(_whole(asked, "series"), *_stretch(asked)),
            "pulses": lambda asked: self._document(asked).pulses(_whole(asked, "series"), *_stretch(asked)),
            "spectrum": lambda asked: self._document(asked).spectrum(
                _whole(asked, "series"), *_stretch(asked)
            ),
            "draft": self._draft,
            "processed": lambda asked: self._document(asked).process_state(),
            "job": lambda asked: self.jobs.job(_whole(asked, "id")).told(),
            "results": lambda _: {"results": self.results.listed()},
        }
        self.told: dict[str, Callable[[Mapping[str, Any]], Any]] = {
            "preview": self._preview,
            "save": self._save,
            "vessel": self._save_vessel,
            "process": self._process,
            "job": self._begin,
            "stop": lambda content: self.jobs.stop(_number(content, "id")).told(),
        }

    def open(self, path: Path, rate_hz: float | None = None, trial: Path | None = None) -> int:
        """Open a log, unless it is open, and return the number of its document."""
        key = (path.resolve(), trial and trial.resolve())
        with self._lock:
            if key not in self._documents:
                self._documents[key] = len(self._open)
                self._open.append(Document(path, rate_hz, trial))
            return self._documents[key]

    def open_trial(self, path: Path) -> list[int]:
        """Open a trial's logs and return their documents' numbers, in order; paths are relative to the trial's folder."""
        logs, rate_hz = _logs_of(path)
        return [self.open(log, rate_hz, path) for log in logs]

    def open_log(self, path: Path, rate_hz: float | None = None) -> int:
        """Open a log, with the newest TRIAL.toml in the folder that names it, and return its document's number."""
        for trial in self.trials_of(path):
            return self.open(path, rate_hz or _logs_of(trial)[1], trial)
        return self.open(path, rate_hz)

    def trials_of(self, path: Path) -> list[Path]:
        """Trials in the folder that name a log, newest first."""
        found, log = [], path.resolve()
        for file, _ in self._files(".toml"):
            with contextlib.suppress(*UNREADABLE):
                if log in [one.resolve() for one in _logs_of(file)[0]]:
                    drafts.read_draft(
                        file
                    )  # raises for a file that the page can't edit, which is then skipped
                    found.append((file.stat().st_mtime_ns, file))
        return [file for _, file in sorted(found, reverse=True)]

    def document(self, number: int) -> Document:
        """Document with this number; `InputError` if there is none."""
        if number >= len(self._open):
            raise InputError(f"doc: {number}, expected a document that is open")
        return self._open[number]

    def tiles(self, asked: Asked) -> bytes:
        """Concatenated tiles; the request's `want` lists them as series.level.index, separated by commas."""
        series = self._document(asked).series()
        wanted = _text(asked, "want").split(",")
        if len(wanted) > MOST_TILES:
            raise InputError(f"want: {len(wanted)} tiles, expected {MOST_TILES} at most")
        jobs: dict[int, list[tuple[int, int, int]]] = {}
        for place, want in enumerate(wanted):
            found = re.fullmatch(r"(\d{1,6})\.(\d{1,2})\.(\d{1,9})", want, re.ASCII)
            if found is None or int(found[1]) >= len(series):
                raise InputError(f"want: {want!r}, expected series.level.index")
            jobs.setdefault(int(found[1]), []).append((place, int(found[2]), int(found[3])))
        parts = [b""] * len(wanted)

        def fill(index: int) -> None:
            for place, level, tile in jobs[index]:
                parts[place] = series[index].tile(level, tile)

        # Each channel is read by one thread, on all processors.
        side_by_side([partial(fill, index) for index in jobs], threading.Event())
        return b"".join(parts)

    def _document(self, asked: Mapping[str, Any]) -> Document:
        return self.document(_whole(asked, "doc"))

    def _folder(self, _: Asked) -> dict[str, Any]:
        logs: list[dict[str, Any]] = []
        trials: list[dict[str, Any]] = []
        others: list[str] = []
        for file, size in self._files():
            try:
                if file.suffix.lower() in suffixes() and size:
                    logs.append({"name": file.name, "doc": self.open_log(file), "bytes": size})
                if file.suffix == ".toml" and size < LARGEST_TOML:
                    trials += [
                        {"name": file.name, "log": self._open[number].path.name, "doc": number}
                        for number in self.open_trial(file)
                    ]
            except UNREADABLE:
                others.append(file.name)
        shown: dict[str, list[Any]] = {"logs": logs, "trials": trials, "others": others}
        return {"folder": self.folder.name, **{key: found[:MOST_ENTRIES] for key, found in shown.items()}}

    def _files(self, suffix: str = "") -> Iterator[tuple[Path, int]]:
        """Yield the regular files of the folder with their sizes; with a suffix, only small files that have it."""
        for entry in sorted(self.folder.iterdir())[: 20 * MOST_ENTRIES]:
            with contextlib.suppress(OSError):
                status = entry.stat()
                if not stat.S_ISREG(status.st_mode) or entry.name.startswith("."):
                    continue
                if not suffix or (entry.suffix == suffix and status.st_size < LARGEST_TOML):
                    yield entry, status.st_size

    def _faults(self, asked: Asked) -> dict[str, Any]:
        work = self._document(asked).faults.begin()
        work.done.wait(0.2)
        return {**work.state(), **(work.result or {})}

    def _within(self, asked: Asked) -> dict[str, Any]:
        return self._document(asked).within(
            _text(asked, "driver"), asked.get("load") or None, *_stretch(asked)
        )

    def _draft(self, asked: Asked) -> dict[str, Any]:
        document = self._document(asked)
        channels = [one.channel for one in document.raw.wait()]
        path = document.trial or self._free("TRIAL", document.path.stem, f"{document.path.stem}-trial")
        known = document.trial is not None
        draft = drafts.read_draft(path) if known else Draft(name=document.path.stem)
        return {
            "draft": draft.model_dump(mode="json"),
            "file": path.name,
            "version": drafts.version_of(path) if known else "",
            "kinds": [[kind, KINDS.get(kind, kind)] for kind in WINDOW_KINDS],
            "vessels": self._vessels(),
            "vessel_form": {"fields": drafts.fields(), "file": self._free("vessel").name},
            "speed_units": sorted(TO_RPM),
            "factors": {channel.name: drafts.factors(channel.unit) for channel in channels},
            "guess": [one.model_dump(mode="json") for one in drafts.guessed(channels)],
            "others": [
                {"name": other.name, "doc": self.open(document.path, _logs_of(other)[1], other)}
                for other in self.trials_of(document.path)
                if other.resolve() != self._own(document)
            ],
            "logs": [
                {"name": other.path.name, "doc": number}
                for number, other in enumerate(self._open)
                if known and other.trial == document.trial
            ],
        }

    def _free(self, *stems: str) -> Path:
        """First unused file name: one of the stems, or the last stem with a number."""
        numbered = (f"{stems[-1]}-{number}" for number in range(2, MOST_ENTRIES))
        for stem in (*stems, *numbered):
            path = self.folder / f"{stem}.toml"
            if NAME.fullmatch(path.name) and not path.exists():
                return path
        return self.folder / f"{stems[0]}.toml"

    def _vessels(self) -> list[str]:
        own = []
        for file, _ in itertools.islice(self._files(".toml"), 50):
            with contextlib.suppress(*UNREADABLE):
                if "gearbox" in read_tables(file):
                    Vessel.load(str(file))
                    own.append(file.name)
        return [*own, *(name for name in built_in("vessels") if name != NO_VESSEL)]

    def _text_of(self, content: Mapping[str, Any]) -> tuple[Document, Path, str]:
        document = self._document(content)
        draft = validated(content.get("draft") or {}, Draft, "draft")
        path = self._writable(content.get("file"))
        old = None
        if path.exists() and document.trial is not None and path == self._own(document):
            old = read_text(path, "a TRIAL.toml")
        elif document.trial is not None:
            old = read_text(document.trial, "a TRIAL.toml")
        log = document.path.resolve()
        shown = log.relative_to(self.folder).as_posix() if log.is_relative_to(self.folder) else str(log)
        rates_hz = {one.channel.name: one.channel.rate_hz for one in document.raw.wait()}
        return document, path, drafts.written(draft, old, shown, document.rate_hz, rates_hz)

    def _own(self, document: Document) -> Path | None:
        return document.trial and document.trial.resolve()

    def _writable(self, name: Any) -> Path:
        """Path of a writable file in the trial's folder, from its name."""
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise InputError(f"file: found {name!r}, expected a name like TRIAL.toml, without a folder")
        path = self.folder / name
        if (
            path.is_symlink()
            or path.parent.resolve() != self.folder
            or (path.exists() and not path.is_file())
        ):
            raise InputError(f"{name}: is not an ordinary file in the trial's folder; choose another name")
        return path

    def _trial(self, text: str, path: Path) -> Trial:
        """Trial described by the text of a TRIAL.toml; paths of logs and vessel are relative to the viewed folder."""
        trial = drafts.checked(text, path.name)
        header = trial.trial
        changes: dict[str, Any] = {"log": tuple(str(self.folder / log) for log in header.log)}
        if (self.folder / header.vessel).is_file():
            changes["vessel"] = str(self.folder / header.vessel)
        return trial.model_copy(update={"trial": header.model_copy(update=changes)})

    def _preview(self, content: Mapping[str, Any]) -> dict[str, Any]:
        _, path, text = self._text_of(content)
        problems = drafts.problems(text, path.name)
        if not problems:
            try:
                Vessel.load(self._trial(text, path).trial.vessel)
            except InputError as wrong:
                problems = [{"at": "", "text": str(wrong)}]
        return {"text": text, "problems": problems}

    def _save(self, content: Mapping[str, Any]) -> dict[str, Any]:
        with self._saving:
            document, path, text = self._text_of(content)
            self._trial(text, path)
            known = content.get("version", "")
            if drafts.version_of(path) != known:
                what = "exists already" if not known else "was changed by another program since it was read"
                raise InputError(f"{path.name}: {what}; save under another name, or load the page anew")
            write_text_atomically(path, text)
            trial = self.open(document.path, document.rate_hz, path)
            return {"file": path.name, "version": drafts.version_of(path), "doc": trial}

    def _save_vessel(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Write a new vessel file from the form; existing files are not overwritten."""
        values = content.get("values")
        if not isinstance(values, dict) or not all(isinstance(value, str) for value in values.values()):
            raise InputError("values: expected a text for each key of the form")
        with self._saving:
            path = self._writable(content.get("file"))
            text = drafts.vessel_file(values, path.name)
            if path.exists():
                raise InputError(f"{path.name}: exists already; choose another name for the ship's file")
            write_text_atomically(path, text)
        return {"file": path.name, "vessels": self._vessels()}

    def _process(self, content: Mapping[str, Any]) -> dict[str, Any]:
        document, path, text = self._text_of(content)
        return document.process(self._trial(text, path))

    def _begin(self, content: Mapping[str, Any]) -> dict[str, Any]:
        kind = content.get("kind")
        if kind not in ("check", "run"):
            raise InputError(f"kind: found {kind!r}, expected check or run")
        return self.jobs.begin(kind, self._writable(content.get("file"))).told()


def _logs_of(path: Path) -> tuple[list[Path], float | None]:
    """Logs named in a TRIAL.toml, and their rate [Hz] if given."""
    header = read_tables(path).get("trial")
    header = header if isinstance(header, dict) else {}
    logs = header.get("log", [])
    logs = [logs] if isinstance(logs, str) else logs
    if not logs or not all(isinstance(log, str) for log in logs):
        raise InputError(f"{path}: trial.log: found no log, expected the path of a log")
    return [path.parent / log for log in logs], header.get("rate_hz")


def _text(asked: Mapping[str, Any], key: str) -> str:
    value = asked.get(key)
    if not isinstance(value, str):
        raise InputError(f"{key}: found nothing, expected a text")
    return value


def _whole(asked: Mapping[str, Any], key: str) -> int:
    value = asked.get(key)
    if not re.fullmatch(r"\d{1,9}", str(value), re.ASCII):
        raise InputError(f"{key}: found {value!r}, expected a whole number")
    return int(str(value))


def _number(content: Mapping[str, Any], key: str) -> int:
    return _whole({key: json.dumps(content.get(key))}, key)


def _stretch(asked: Asked) -> tuple[float, float]:
    try:
        start_s, stop_s = (float(_text(asked, key)) for key in ("from", "to"))
    except ValueError:
        raise InputError("from, to: expected numbers of seconds") from None
    if not -1e15 < start_s < stop_s < 1e15:
        raise InputError(f"from {start_s:g} to {stop_s:g} s: expected a stretch that is not empty")
    return start_s, stop_s
