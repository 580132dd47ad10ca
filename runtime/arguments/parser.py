"""How a command is declared: its parser, its examples, and the function that carries it out, by name."""

from __future__ import annotations

import argparse
import math
from typing import NoReturn, TypeAlias


class Parser(argparse.ArgumentParser):
    """Errors in one line, with exit code 2."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and exit."""
        self.exit(2, f"palpate: {message}; see '{self.prog} --help'\n")


Commands: TypeAlias = "argparse._SubParsersAction[Parser]"


def parser(name: str, description: str, examples: str) -> Parser:
    """The parser of the program."""
    return Parser(
        prog=name, description=description, epilog=examples, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add(commands: Commands, name: str, text: str, examples: str, function: str) -> Parser:
    """Add a command; `function` is "module:name" of what carries it out, imported only when it is called."""
    command = commands.add_parser(
        name,
        help=text,
        description=text[:1].upper() + text[1:] + ".",
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.set_defaults(function=function)
    return command


def add_meeting_point(command: Parser, whose: str) -> None:
    """Add how a command finds the router that a cell or a player meets on."""
    command.add_argument(
        "--cell", metavar="CELL", help=f"cell file whose [bus] says where {whose} is and which keys open it"
    )
    command.add_argument(
        "--port", type=int, metavar="PORT", help="of the Zenoh router (default: that of the cell, or 7447)"
    )


def seconds(text: str) -> float:
    """A number of seconds, for `type=`."""
    value = float(text)
    if not 0 <= value <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is no number of seconds from 0 to 3600")
    return value


def moment(text: str) -> float:
    """A session time [s], for `type=`; negative ones count from the end."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= 1e9:
        raise argparse.ArgumentTypeError(f"{text} is no time in seconds")
    return value


def days(text: str) -> int:
    """A number of days, for `type=`."""
    if not (text.isdecimal() and 1 <= int(text) <= 7000):
        raise argparse.ArgumentTypeError(f"{text} is no number of days from 1 to 7000")
    return int(text)


def frequency(text: str) -> float:
    """A frequency [Hz], for `type=`."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.1 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"{text} is no frequency from 0.1 to 1000 Hz")
    return value
