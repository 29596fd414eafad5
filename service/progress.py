"""Progress and time left of a long command, on a terminal's stderr only."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def bar(name: str, total: int, *, quiet: bool = False) -> Iterator[Callable[[int], None]]:
    """A bar; call what it yields with the number done so far."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    with Progress(
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=quiet or not console.is_terminal,
    ) as shown:
        task = shown.add_task(name, total=total)
        yield lambda done: shown.update(task, completed=done)
