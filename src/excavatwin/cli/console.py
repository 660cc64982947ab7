"""What the user sees: progress on stderr, results on stdout."""

from __future__ import annotations

import re
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import TaskID

    from excavatwin.scene.progress import Progress


class Lines:
    """Progress for logs: a line when a stage begins, and one every ten seconds while it works."""

    every = 10.0

    def __init__(self) -> None:
        self.stage = ""
        self._begin = self._last = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        stage = stage.partition(": ")[0]
        if stage != self.stage or now - self._last >= self.every:
            count = f" {done}/{total}" if total > 1 else ""
            print(f"[{now - self._begin:6.1f} s] {stage}{count}", file=sys.stderr, flush=True)
            self.stage, self._last = stage, now


class Bars:
    """Progress for people: one bar for each stage, finished ones stay."""

    def __init__(self, bars: RichProgress) -> None:
        self.stage = ""
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        group, _, step = stage.partition(": ")  # "fusion: terrain" is a step of "fusion"
        if group != self.stage:
            self.finish()
            self.stage = group
            if group not in self._tasks:
                self._tasks[group] = self._bars.add_task(group, total=None)
        known = total if total > 1 else None  # one step tells nothing: let the bar pulse
        self._bars.update(
            self._tasks[group], description=f"{group} {step}", completed=done if known else 0, total=known
        )

    def finish(self) -> None:
        """The stage at work is done."""
        if self.stage:
            task = self._tasks[self.stage]
            steps = self._bars.tasks[task].total or 1
            self._bars.update(task, description=self.stage, total=steps, completed=steps)
            self._bars.stop_task(task)


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Bars on a terminal, plain lines elsewhere."""
    if not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(finished_text="[green]✓[/]"),
        TextColumn("{task.description:<24}"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bars:
        progress = Bars(bars)
        yield progress
        progress.finish()


def consent(download: bool) -> Callable[[str], bool]:
    """Who answers when weights would have to be downloaded: the flag, a person at a terminal, or nobody (no)."""

    def ask(question: str) -> bool:
        if download:
            print(f"{question.rstrip('?')}: yes (--download)", file=sys.stderr)
            return True
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False  # nobody there to ask; the refusal that follows says what could be done
        print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    return ask


def say(*lines: str) -> None:
    """Results, on stdout."""
    print(*lines, sep="\n", flush=True)


def complain(sentence: str) -> None:
    """One sentence, on stderr."""
    print(f"excavatwin: {' '.join(sentence.split())}", file=sys.stderr, flush=True)


def wrapped(head: str, text: str, width: int = 110) -> list[str]:
    """Text behind a head, as a hanging paragraph; a number and its unit stay on one line."""
    joined = re.sub(r"(?<=\d) (?=(?:%|m|s|GB|min|unit)\b|%)", "\u00a0", text)
    rows = textwrap.wrap(joined, width, initial_indent=head, subsequent_indent=" " * len(head), break_on_hyphens=False)
    return [row.replace("\u00a0", " ") for row in rows]
