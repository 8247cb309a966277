"""Printing of the commands: sentences and tables on two consoles, and a progress bar."""

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
    """Set whether only warnings are printed, and whether standard output is reserved for a JSON document."""
    console.quiet = console.quiet if quiet is None else quiet
    console.stderr = console.stderr if as_json is None else as_json


def give(record: dict) -> None:
    """Print the result as one JSON document on standard output if `--json` is given."""
    if console.stderr:
        print(json.dumps(record, indent=1, allow_nan=False))


def say(sentence: str, on: Console = console) -> None:
    """Print a sentence wrapped between words; a word wider than the window stays whole."""
    begin = sentence[: len(sentence) - len(sentence.lstrip())]
    wide = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": f"{begin}  "}
    lines = textwrap.wrap(sentence.lstrip(), on.width, initial_indent=begin, **wide)
    on.print("\n".join(lines), markup=False, soft_wrap=True)


def note(sentence: str) -> None:
    """Print a note on a result; with `--quiet` on standard error."""
    say(f"note: {sentence}", notices if console.quiet else console)


def complain(sentence: str) -> None:
    """Print an error as one line, of any length, on standard error."""
    notices.print(f"skyfit: {sentence}", style="red", markup=False, soft_wrap=True)


def warn(sentence: str) -> None:
    """Print a warning as one line on standard error."""
    notices.print(f"note: {sentence}", markup=False, soft_wrap=True)


def written(paths: Iterable[Path]) -> None:
    say(f"written: {', '.join(map(str, paths))}")


def table(title: str) -> Table:
    return Table(title=title, box=SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0), pad_edge=False)


def show(rows: Table) -> None:
    """Print a table below its title; cells wrap between words, and a table wider than the window is not cut."""
    title, rows.title = rows.title, None
    say(str(title))
    for column in rows.columns:
        cells = [str(cell) for cell in (column.header, *column.cells)]
        column.min_width = max(len(word) for cell in cells for word in ("", *cell.split()))
        # A column whose cells cannot wrap shall not be narrowed
        column.no_wrap = column.min_width == max(len(line) for cell in cells for line in ("", *cell.splitlines()))
    console.print(rows, markup=False, crop=False)
    console.print()


@contextmanager
def progress(title: str, kind: str = "", size: str = ""):
    """Show a progress bar on standard error, with the time that such calls took before; yield `progress(done, of)`.

    `kind` and `size` of the call are texts that are equal if the same programs run; with `kind` "" no time is shown.
    """
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    # If standard error is a file it gets neither a bar nor the empty line after it
    hidden = console.quiet or not notices.is_terminal
    with waiting(kind, size) as told:
        with Progress(*columns, console=notices, transient=True, disable=hidden) as bar:
            task = bar.add_task(f"{title}{told}", total=None)
            yield lambda done, of: bar.update(task, completed=done, total=of)
