"""`shipfp reproduce` compares results with the thesis's; `shipfp compare` compares two fingerprints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from shipfp_rs.cli.options import (
    MOST_DRAWS,
    Json,
    Replace,
    file_argument,
    file_option,
    folder_for,
    new_file,
    number_option,
    print_results,
    print_table,
    print_text,
    probability,
    progress,
)
from shipfp_rs.errors import InputError

if TYPE_CHECKING:
    from shipfp_rs.assessment.comparison import Comparison
    from shipfp_rs.reproduce import Reproduction
    from shipfp_rs.reproduce.pictures import Responses


Progress = Callable[[int, int], None]

reproduce = typer.Typer(
    help="Reproduce the thesis's tables, ours beside the printed ones.", no_args_is_help=True
)

COLUMNS = {
    "7.1": "tau_n g vK_p K_p/K_i p tau_prop T_d T_set vK_p/tau_n (p-g)/(vK_i)+T_set-T_f",
    "twin": "tau_n g p tau_prop vK_p vK_i T_d T_set",
}
"""Parameters shown, by table; other tables show all."""
PICTURED = 100
"""Number of draws whose scatter gives the band of a figure, if the experiments are in the fingerprint's folder."""
TOO_WIDE = ("5.1",)
"""Tables that are only in the JSON output, since they are too wide to print."""
FITS = {
    "dn": "fit n [%]",
    "dM": "fit M [%]",
    "validation dn": "validation n [%]",
    "validation dM": "validation M [%]",
}


@reproduce.command()
def fullscale(
    out: Annotated[Path | None, file_option("DIR", "Folder for fullscale.json and the pictures.")] = None,
    json: Json = False,
) -> None:
    """Repeat chapters 6 and 7 from the tug's published numbers: Tables 6.8 to 7.3, and with --out pictures of them."""
    from shipfp_rs.reproduce import fullscale as tables

    _reproduce("fullscale.json", tables.reproduce, tables.responses, tables.FILES, out, json=json)


@reproduce.command()
def virtual(
    out: Annotated[Path | None, file_option("DIR", "Folder for virtual.json and the pictures.")] = None,
    json: Json = False,
) -> None:
    """Repeat chapters 3 to 5 on the virtual ship: Tables 3.4 to 5.2, and with --out pictures of them."""
    from shipfp_rs.reproduce import virtual as tables

    _reproduce("virtual.json", tables.reproduce, tables.responses, tables.FILES, out, json=json)


def _reproduce(
    file: str,
    compute: Callable[[Progress], Reproduction],
    responses: Callable[[Reproduction], Responses] | None,
    files: Sequence[str],
    out: Path | None,
    *,
    json: bool,
) -> None:
    """Compute the tables, write them and their figures to a folder if given, and print them."""
    from shipfp_rs.support.files import json_text, write_text_atomically

    with folder_for(out, file, files) as folder, progress() as notify:
        found = compute(lambda done, jobs: notify(f"refitting, {done} of {jobs} done"))
        content = found.to_dict()
        if folder is not None:
            write_text_atomically(folder / file, json_text(content))
            from shipfp_rs.reproduce.pictures import draw

            draw(
                folder,
                found,
                lambda done, count: notify(f"drawing, {done} of {count} done"),
                responses=responses,
            )
    print_results(content, lambda: _print(found), out, json=json)


@reproduce.command()
def twin(
    draws: Annotated[
        int, typer.Option(min=1, max=MOST_DRAWS, metavar="N", help="Ships whose short chirp is identified.")
    ] = 1,
    out: Annotated[Path | None, file_option("DIR", "Folder for twin.json and the picture.")] = None,
    json: Json = False,
) -> None:
    """Identify a simulated ship of known parameters from the tug's trial: Table 7.1 with the true values."""
    from shipfp_rs.reproduce import twin as study

    _reproduce("twin.json", lambda step: study.reproduce(draws, step), None, study.FILES, out, json=json)


def _print(found: Reproduction) -> None:
    tables = {row.table: [other for other in found.rows if other.table == row.table] for row in found.rows}
    for table, rows in tables.items():
        if table in TOO_WIDE:
            continue
        names = COLUMNS.get(table, "").split() or list(
            dict.fromkeys(name for row in rows for name in row.parameters)
        )
        fits = [output for output in FITS if any(output in row.fit for row in rows)]
        cells = []
        for row in rows:
            about = ", ".join(part for part in (row.case, row.way, row.structure) if part)
            figures = [*map(row.parameters.get, names), *map(row.fit.get, fits)]
            cells.append([about, *map(_shown, figures)])
        title = found.title if len(tables) == 1 else table if table.startswith("eq.") else f"Table {table}"
        head = ["case, way, structure", *names, *(FITS[output] for output in fits)]
        print_table(title, head, cells)
        notes: dict[str, list[str]] = {}
        for row in rows:
            if row.notes and row.way != "printed":
                notes.setdefault(row.notes, []).append(", ".join(filter(None, (row.case, row.structure))))
        print_text(*(f"{'; '.join(cases)}: {note}" for note, cases in notes.items()))
    print_text("", *found.verdict)


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"


def compare(
    before: Annotated[Path, file_argument("A.json", "Fingerprint before, as `shipfp run` writes it.")],
    after: Annotated[Path, file_argument("B.json", "Fingerprint after.")],
    level: Annotated[float, number_option("P", "Probability of a false alarm.", probability)] = 0.05,
    out: Annotated[
        Path | None, file_option("FILE.png", "Picture of both step and frequency responses.")
    ] = None,
    force: Replace = False,
    json: Json = False,
) -> None:
    """Compare two fingerprints of a ship: which parameters changed, and whether by more than chance."""
    from shipfp_rs.assessment.comparison import compare as compare_fingerprints
    from shipfp_rs.identification.fingerprint import Fingerprint
    from shipfp_rs.support.files import ending_in, replacing

    if out is not None:
        if any(out.exists() and path.exists() and out.samefile(path) for path in (before, after)):
            raise InputError(f"{out}: one of both fingerprints, expected a new file; choose another name")
        new_file(ending_in(out, ".png"), force=force)
    first, second = Fingerprint.load(before), Fingerprint.load(after)
    with progress() as notify:
        notify("comparing")
        comparison = compare_fingerprints(first, second, level=level)
    if out is not None:
        from shipfp_rs.plot.estimates import draw

        labels = [path.name if before.name != after.name else str(path) for path in (before, after)]
        known = dict(zip(labels, (first, second), strict=True))
        drawn = {
            label: one.draws(PICTURED)
            for label, one in known.items()
            if one.experiments and one.engine_described
        }
        figure = draw(known, drawn)
        with replacing(out) as temporary:
            figure.savefig(temporary, format="png")
    title = f"Changes from {before} to {after}"
    print_results(comparison.to_dict(), lambda: _print_comparison(title, comparison), out, json=json)


def _print_comparison(title: str, comparison: Comparison) -> None:
    from shipfp_rs.assessment.comparison import HEAD

    print_table(title, HEAD, comparison.rows())
    print_text(*comparison.verdict, *comparison.remarks)
