"""Reports: runs on the terminal, and one HTML page with tables, rates and pictures, complete in one file.

Pictures are embedded, styles are in the page, nothing is loaded from elsewhere; the page follows the reader's choice of
light or dark.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from iga.errors import InputError
from iga.exchange.files import write_text
from studies.table import Column, Table, Value, formatted, render, render_rates

if TYPE_CHECKING:
    from rich.console import Console

    from studies.study import Run

_TYPES = {".png": "image/png", ".svg": "image/svg+xml", ".jpg": "image/jpeg"}

_CSS = """
:root { color-scheme: light dark; --ink: #1c2128; --soft: #5b6572; --line: #d8dde3; --paper: #ffffff; --tint: #f5f7f9;
  --accent: #0a5fa5; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ec; --soft: #9aa5b1; --line: #353d47; --paper: #14181d;
  --tint: #1b2127; --accent: #6db3f2; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 3rem 1.5rem 5rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .4rem; letter-spacing: -.01em; }
h2 { font-size: 1.3rem; margin: 3.2rem 0 .4rem; padding-top: 1.2rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: .4rem 0 1rem; }
.lead, figcaption, .note { color: var(--soft); }
nav { margin: 1.4rem 0 0; columns: 2; column-gap: 2rem; }
nav a { display: block; color: var(--accent); text-decoration: none; padding: .12rem 0; }
nav a:hover { text-decoration: underline; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding-bottom: .35rem; }
th { text-align: right; font-weight: 600; border-bottom: 1.5px solid var(--ink); vertical-align: bottom; }
th small { display: block; font-weight: 400; color: var(--soft); }
th, td { padding: .28rem .85rem; white-space: nowrap; }
td { text-align: right; border-bottom: 1px solid var(--line); }
.text { text-align: left; }
tbody tr:hover { background: var(--tint); }
tr.group td { border-top: 1.5px solid var(--line); }
.pictures { display: flex; flex-wrap: wrap; gap: 1.4rem; margin: 1.4rem 0; align-items: flex-start; }
figure { margin: 0; flex: 1 1 22rem; max-width: 34rem; }
figure.broad { flex-basis: 100%; max-width: 60rem; }
figure div { background: #ffffff; border: 1px solid var(--line); border-radius: 8px; padding: .7rem; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .88rem; padding: .5rem .2rem 0; }
.short { color: #c4320a; font-weight: 600; }
@media print { nav { display: none; } figure { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Picture:
    """An image file and what it shows; a broad one takes the whole width."""

    path: Path
    caption: str
    broad: bool = False


@dataclass(frozen=True)
class Section:
    """A part of a report: text (paragraphs parted by an empty line), a table with its rates, pictures."""

    title: str
    text: str = ""
    table: Table | None = None
    pictures: tuple[Picture, ...] = ()
    note: str = ""


def wide_console() -> Console:
    """Console on standard output; a pipe has no width, so it gets enough for any table and no column is cut."""
    from rich.console import Console

    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=200)


def print_run(run: Run) -> None:
    """Print what a study found to standard output: table, rates, what they say, and files written or not."""
    console = wide_console()
    console.print(render(run.result.table, f"{run.name} ({run.seconds:.1f} s)"))
    rates = render_rates(run.result.table)
    if rates is not None:
        console.print(rates)
    if run.result.summary:
        console.print(run.result.summary, markup=False)
    for path in run.files:
        console.print(str(path), style="dim", markup=False)
    for why in run.undrawn:
        console.print(why, style="red", markup=False)


def write_report(path: str | Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Write the page, whole or not at all.

    Raises
    ------
    InputError : a picture is missing or of an unknown kind, or the page cannot be written.
    """
    links = "".join(f'<a href="#part{k}">{escape(s.title)}</a>' for k, s in enumerate(sections))
    parts = "".join(_section(k, section) for k, section in enumerate(sections))
    page = (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_CSS}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>\n<nav>{links}</nav>\n{parts}'
        "</main>\n</body>\n</html>\n"
    )
    write_text(path, page)
    return Path(path)


def _section(number: int, section: Section) -> str:
    out = [f'<section id="part{number}">\n<h2>{escape(section.title)}</h2>\n']
    out += [f"<p>{escape(part.strip())}</p>\n" for part in section.text.split("\n\n") if part.strip()]
    if section.pictures:
        out.append('<div class="pictures">\n' + "".join(map(_figure, section.pictures)) + "</div>\n")
    if section.table is not None:
        out.append(_table(section.table))
        out.append(_rates(section.table))
    if section.note:
        out.append(f'<p class="note">{escape(section.note)}</p>\n')
    return "".join([*out, "</section>\n"])


def _figure(picture: Picture) -> str:
    kind = _TYPES.get(picture.path.suffix.lower())
    if kind is None:
        raise InputError(f"{picture.path}: a report takes pictures in png, svg or jpg")
    try:
        data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    except OSError as error:
        raise InputError(f"{picture.path}: cannot be read: {error.strerror}") from None
    caption = escape(picture.caption)
    broad = ' class="broad"' if picture.broad else ""
    image = f'<img src="data:{kind};base64,{data}" alt="{caption}">'
    return f"<figure{broad}><div>{image}</div><figcaption>{caption}</figcaption></figure>\n"


def _table(made: Table) -> str:
    head = "".join(_heading(column) for column in made.columns)
    keys = [at for at, column in enumerate(made.columns) if column.key]
    first = keys[0] if keys else None
    body, before = [], None
    for row in made.rows:
        # A rule parts the groups of rows that agree in the first key.
        group = first is not None and len(keys) > 1 and before is not None and row[first] != before
        before = row[first] if first is not None else None
        cells = "".join(_cell(column, value) for column, value in zip(made.columns, row, strict=True))
        body.append(f"<tr{' class=group' if group else ''}>{cells}</tr>\n")
    return _wide(f"<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(body)}</tbody>\n")


def _wide(content: str) -> str:
    return f'<div class="wide"><table>\n{content}</table></div>\n'


def _heading(column: Column) -> str:
    unit = f"<small>{escape(column.unit)}</small>" if column.unit else ""
    side = ' class="text"' if column.kind == "text" else ""
    return f"<th{side}>{escape(column.name.replace('_', ' '))}{unit}</th>"


def _cell(column: Column, value: Value) -> str:
    side = ' class="text"' if column.kind == "text" else ""
    return f"<td{side}>{escape(formatted(column, value))}</td>"


def _rates(made: Table) -> str:
    rates = made.rates()
    if not rates:
        return ""
    rows = []
    for rate in rates:
        theory = "–" if rate.expected is None else f"{rate.expected:.3g}"
        short = rate.expected is not None and rate.last < rate.expected - 0.1
        mark = ' class="short"' if short else ""
        group = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in rate.group)
        what = f"{rate.y.replace('_', ' ')} over {rate.x}"
        rows.append(
            f'<tr><td class="text">{escape(group) or "all"}</td><td class="text">{escape(what)}</td>'
            f"<td>{rate.levels}</td><td>{rate.fit:.2f}</td><td{mark}>{rate.last:.2f}</td><td>{theory}</td></tr>\n"
        )
    words = [' class="text">of', ' class="text">rate', ">levels", ">fit", ">last pair", ">theory"]
    head = "".join(f"<th{word}</th>" for word in words)
    return _wide(
        f"<caption>Observed rates</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{''.join(rows)}</tbody>\n"
    )
