"""How a cell that waits for a person shows it in a terminal, and takes the answer there."""

from __future__ import annotations

import getpass
import os
import select
import sys
import termios
from dataclasses import dataclass

from rich.console import Console
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from runtime.errors import InputError, alternatives
from runtime.intervention import CHOICES
from runtime.messages import Choice, Intervention, InterventionAnswer, Need
from runtime.playback.keys import in_foreground

PROMPT = "r, s or a, and a note if you like, then Enter"


def show_request(request: Intervention, console: Console) -> None:
    """Print what is needed and what can be answered: framed on a terminal, plain lines elsewhere."""
    need = Need(request.need).name.lower().replace("_", " ")
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("happened", Text(request.reason))
    table.add_row("to do", Text(request.task))
    for name in CHOICES:
        if getattr(request, name):
            table.add_row(Text(name, style="bold"), Text(getattr(request, name)))
    title = f"request {request.number}: board {request.board} hole {request.hole}: {need}"
    if console.is_terminal:
        console.print(Panel(table, title=Text(title), border_style="yellow"))
    else:
        console.print(title, highlight=False, markup=False, soft_wrap=True)
        console.print(table)


def choice_of(word: str) -> Choice:
    """The choice that a word, or its first letter, stands for. Raises InputError."""
    for name, choice in CHOICES.items():
        if word.lower() in {name, name[0]}:
            return choice
    raise InputError(f"{word!r} is no answer; {alternatives(word, CHOICES)}")


def answer_of(line: str, request: Intervention) -> InterventionAnswer:
    """What a typed line answers to a request: a choice, then a note if there is more. Raises InputError."""
    word, _, note = line.strip().partition(" ")
    return InterventionAnswer(request.number, choice_of(word), user(), note.strip())


def user() -> str:
    """Who answers, unless told otherwise."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return "unknown"


@dataclass
class TypedLines:
    """Lines typed into the terminal of this process, without waiting for them; none where there is no terminal."""

    _begun: str = ""

    @property
    def available(self) -> bool:
        """Whether somebody could type here: a terminal, and this process in its foreground."""
        try:
            return in_foreground(sys.stdin.fileno())
        except (OSError, ValueError):  # no standard input, or it is closed
            return False

    def forget(self) -> None:
        """Drop what was typed before: it was no answer to what is asked from now on."""
        self._begun = ""
        if self.available:
            termios.tcflush(sys.stdin.fileno(), termios.TCIFLUSH)

    def next(self) -> str | None:
        """The next whole line if one has been typed."""
        descriptor = sys.stdin.fileno() if self.available else None
        while descriptor is not None and "\n" not in self._begun:
            if not select.select([descriptor], [], [], 0)[0]:
                break
            data = os.read(descriptor, 1024)
            if not data:
                break
            self._begun += data.decode(errors="replace")
        line, end, rest = self._begun.partition("\n")
        if not end:
            return None
        self._begun = rest
        return line
