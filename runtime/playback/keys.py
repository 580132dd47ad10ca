"""The keyboard of a player: which key gives which command, and a terminal that tells keys at once."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from runtime.messages import PlayerCommand

HELP = "space pause  s step  left/right 5 s  up/down rate  0 start  q quit"
_SKIP = 5.0  # [s]
_KEYS = {
    " ": ("toggle", 0.0),
    "s": ("step", 1.0),
    "q": ("quit", 0.0),
    "0": ("skip", -1e9),  # to where playing begins, whatever that is
    "home": ("skip", -1e9),
    "left": ("skip", -_SKIP),
    "right": ("skip", _SKIP),
    "up": ("scale", 2.0),
    "down": ("scale", 0.5),
}
_ESCAPE = 0x1B
_FINAL = {"A": "up", "B": "down", "C": "right", "D": "left", "H": "home"}
_NUMBERED = {"1": "home", "7": "home"}  # ESC [ 1 ~


def command_of(key: str) -> PlayerCommand | None:
    """What a key means; None if nothing."""
    return PlayerCommand(*_KEYS[key]) if key in _KEYS else None


@dataclass
class KeyReader:
    """Keys from the bytes that a terminal sends, however they are cut into pieces."""

    _begun: bytearray = field(default_factory=bytearray)  # of an escape sequence

    def feed(self, data: bytes) -> Iterator[str]:
        """The keys that are complete now: a character, or `up`, `down`, `left`, `right`, `home`."""
        for byte in data:
            key = self._take(byte)
            if key:
                yield key

    def _take(self, byte: int) -> str:
        if byte == _ESCAPE:
            self._begun = bytearray([byte])
            return ""
        if not self._begun:
            return chr(byte) if byte < 0x80 else ""
        self._begun.append(byte)
        if len(self._begun) == 2:
            if byte in b"[O":
                return ""
            self._begun.clear()  # the escape key alone, and then another
            return chr(byte) if byte < 0x80 else ""
        if 0x20 <= byte < 0x40:
            return ""
        sequence = self._begun[2:].decode("latin-1")
        self._begun.clear()
        return _NUMBERED.get(sequence[:-1], "") if sequence[-1] == "~" else _FINAL.get(sequence, "")


@contextlib.contextmanager
def keys_of(terminal: int, press: Callable[[str], None]) -> Iterator[None]:
    """While the block lasts, the terminal of this descriptor tells each key at once, and `press` is called with it.

    `press` is called from a thread. Ctrl-C still interrupts. However the block ends, the terminal is as it was. A
    process in the background leaves the terminal alone, since it would be stopped. For the main thread only.
    """
    if not in_foreground(terminal):
        yield
        return
    before = termios.tcgetattr(terminal)
    wake, waker = os.pipe()

    def listen() -> None:
        reader = KeyReader()
        while True:
            ready, _, _ = select.select([terminal, wake], [], [])
            if wake in ready:
                return
            try:
                data = os.read(terminal, 64)
            except OSError:  # the terminal has gone
                return
            if not data:
                return
            for key in reader.feed(data):
                press(key)

    def resumed(_number: int, _frame: object) -> None:
        if in_foreground(terminal):
            tty.setcbreak(terminal, termios.TCSANOW)

    thread = threading.Thread(target=listen, daemon=True)
    former = signal.signal(signal.SIGCONT, resumed)  # after Ctrl-Z the shell has set the terminal its own way
    try:
        tty.setcbreak(terminal, termios.TCSANOW)
        thread.start()
        yield
    finally:
        signal.signal(signal.SIGCONT, former)
        if in_foreground(terminal):
            with contextlib.suppress(termios.error):
                termios.tcsetattr(terminal, termios.TCSANOW, before)
        if thread.ident is not None:
            os.write(waker, b"\0")
            thread.join()
        os.close(wake)
        os.close(waker)


def in_foreground(terminal: int) -> bool:
    """Whether a descriptor is a terminal, and this process in its foreground: it may take what is typed there."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return False
