"""How a command is declared: its parser, its examples, and the function that carries it out, by name."""

from __future__ import annotations

import argparse
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


def seconds(text: str) -> float:
    """A number of seconds, for `type=`."""
    value = float(text)
    if not 0 <= value <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is no number of seconds from 0 to 3600")
    return value
