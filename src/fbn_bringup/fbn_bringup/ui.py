"""What all commands share: the console, progress bars, and errors that end a command with one clear line."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

__all__ = ["Advance", "CommandError", "err", "escape", "fail", "known_error", "number", "out", "progress", "table"]

out = Console(highlight=False)  # results
err = Console(stderr=True, highlight=False)  # progress and trouble

Advance = Callable[[float, str], None]  # fraction done (0 to 1), what is going on


class CommandError(Exception):
    """A command cannot do its job; the text says why, and what to do."""


def fail(message: str, status: int = 1) -> NoReturn:
    """End the command with a message and an exit status."""
    err.print(f"[bold red]error:[/] {escape(message)}", soft_wrap=True)
    raise typer.Exit(status)


@contextmanager
def progress(title: str) -> Iterator[Advance]:
    """A progress bar on the terminal (nothing elsewhere); yields what advances it."""
    columns = (
        SpinnerColumn(), TextColumn("{task.fields[title]}"), BarColumn(), TaskProgressColumn(),
        TimeElapsedColumn(), TextColumn("[dim]{task.description}"),
    )  # fmt: skip
    hidden = not err.is_terminal
    if hidden:
        err.print(f"{title} …")
    with Progress(*columns, console=err, transient=True, disable=hidden) as bar:
        task = bar.add_task("", total=1.0, title=title)
        yield lambda fraction, text: bar.update(task, completed=fraction, description=text)


def table(title: str, *columns: str, left: int = 1) -> Table:
    """A table in the house style: the first ``left`` columns to the left, numbers to the right."""
    made = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        header_style="dim",
        box=None,
        pad_edge=False,
        caption_justify="left",
    )
    for i, column in enumerate(columns):
        made.add_column(column, justify="left" if i < left else "right")
    return made


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """A number for a table; an unknown one is a dash."""
    if value is None or value != value:
        return "–"
    return f"{round(value, digits) + 0.0:.{digits}f}{unit}"


def known_error(error: BaseException) -> str | None:
    """The text for errors that tell the user enough; None for defects, which deserve their traceback."""
    if os.environ.get("FBN_DEBUG"):
        return None
    if isinstance(
        error, FileNotFoundError | PermissionError | IsADirectoryError | NotADirectoryError | FileExistsError
    ):
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == 28:
        return "no space left on the disk; free some, or choose another place with -o"
    return str(error) if type(error).__module__.startswith("fbn_") else None
