"""Progress on standard error: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from udflow.progress import Progress

SECONDS_BETWEEN_LINES = 5.0
Listener = Callable[[Progress], None]


@contextlib.contextmanager
def shown_progress(quiet: bool) -> Iterator[Listener]:
    """What to call with every `Progress`."""
    if quiet:
        yield lambda progress: None
    elif sys.stderr.isatty():
        with _bar() as listener:
            yield listener
    else:
        yield _Lines()


class _Lines:
    """A line for every new stage and round, and every few seconds within one."""

    def __init__(self) -> None:
        self._place: tuple[str, int] | None = None
        self._next_s = 0.0

    def __call__(self, progress: Progress) -> None:
        place = (progress.stage, progress.round)
        if place == self._place and progress.elapsed_s < self._next_s:
            return
        self._place, self._next_s = place, progress.elapsed_s + SECONDS_BETWEEN_LINES
        sys.stderr.write(
            f"{progress.elapsed_s:7.1f} s  {progress.fraction:4.0%}  {describe(progress)}\n"
        )


def describe(progress: Progress) -> str:
    """One line such as "densifying, round 3 of 13, 12000 points, loss 1.2e-05"."""
    parts: list[str] = [progress.stage]
    if progress.stage == "densifying":
        parts.append(f"round {progress.round} of {progress.rounds}")
    parts.append(f"{progress.points} points")
    if progress.loss is not None:
        parts.append(f"loss {progress.loss:.2e}")
    return ", ".join(parts)


@contextlib.contextmanager
def _bar() -> Iterator[Listener]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda progress: bar.update(
            task, completed=progress.fraction, description=describe(progress)
        )
