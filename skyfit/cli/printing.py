"""How the commands print: on two consoles, in sentences and tables, with a bar while they work."""

import json
import textwrap
from collections.abc import Iterable
from contextlib import contextmanager
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from .waiting import waiting


console = Console(highlight=False)
notices = Console(stderr=True, highlight=False)


def speak(quiet: bool | None = None, as_json: bool | None = None) -> None:
    """Whether nothing is said but what a user must know, and whether a document has standard output for itself."""
    console.quiet = console.quiet if quiet is None else quiet
    console.stderr = console.stderr if as_json is None else as_json


def give(record: dict) -> None:
    """The result as one JSON document on standard output, where `--json` asked for it."""
    if console.stderr:
        print(json.dumps(record, indent=1, allow_nan=False))


def say(sentence: str, on: Console = console) -> None:
    """A sentence in lines that end between words: a word wider than the window stays whole."""
    begin = sentence[: len(sentence) - len(sentence.lstrip())]
    wide = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": f"{begin}  "}
    lines = textwrap.wrap(sentence.lstrip(), on.width, initial_indent=begin, **wide)
    on.print("\n".join(lines), markup=False, soft_wrap=True)


def note(sentence: str) -> None:
    """What a user should know of a result, told on standard error where nothing else is told."""
    say(f"note: {sentence}", notices if console.quiet else console)


def complain(sentence: str) -> None:
    """One line, however long, on standard error."""
    notices.print(f"skyfit: {sentence}", style="red", markup=False, soft_wrap=True)


def warn(sentence: str) -> None:
    """One line on standard error of what does not end the work."""
    notices.print(f"note: {sentence}", markup=False, soft_wrap=True)


def written(paths: Iterable[Path]) -> None:
    say(f"written: {', '.join(map(str, paths))}")


def table(title: str) -> Table:
    return Table(title=title, box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0), pad_edge=False)


def show(rows: Table) -> None:
    """A table under its title: lines of a cell end between words, and a table too wide for the window stays whole."""
    title, rows.title = rows.title, None
    say(str(title))
    for column in rows.columns:
        cells = [str(cell) for cell in (column.header, *column.cells)]
        column.min_width = max(len(word) for cell in cells for word in ("", *cell.split()))
        # what cannot end its lines elsewhere is not what has to give way
        column.no_wrap = column.min_width == max(len(line) for cell in cells for line in ("", *cell.splitlines()))
    console.print(rows, markup=False, crop=False)
    console.print()


@contextmanager
def progress(title: str, kind: str = "", size: str = ""):
    """A bar on standard error, with how long the like took before; yields `progress(done, of)`.

    `kind` of call and `size` of it, in words that are the same where the same programs are run; "" tells of no time.
    """
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    # a file gets no bar, nor the empty line that would end it
    hidden = console.quiet or not notices.is_terminal
    with waiting(kind, size) as told:
        with Progress(*columns, console=notices, transient=True, disable=hidden) as bar:
            task = bar.add_task(f"{title}{told}", total=None)
            yield lambda done, of: bar.update(task, completed=done, total=of)
