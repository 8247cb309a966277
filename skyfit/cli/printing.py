"""How the commands print: on two consoles, in tables, with a bar while they work."""

from contextlib import contextmanager

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table


console = Console()
notices = Console(stderr=True)


def complain(sentence: str) -> None:
    """One line, however long, on standard error."""
    notices.print(f"skyfit: {sentence}", style="red", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress(title: str):
    """A bar on standard error; yields `progress(done, of)`."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=notices, transient=True) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def table(title: str) -> Table:
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
