"""The command line. What each command takes stands in `runtime.arguments`, what it does in `runtime.commands`.

Only the standard library is imported here; each command imports what it needs.
Exit codes: 0 done, 1 the job failed, 2 the input is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

from runtime.arguments import cells, keys, log_contents, logs, measures, posterior
from runtime.arguments.parser import Parser, parser
from runtime.linear_algebra import ONE_THREAD

DESCRIPTION = """\
palpate finds the hole by touch: a robot cell that inserts through-hole parts into circuit
boards without a camera, learns where the holes really are, and records all of it."""

EXAMPLES = """\
examples:
  palpate launch                                  nine IGBTs into one board, meta search, simulated UR3e
  palpate launch --strategy spiral --boards 3     another strategy, three boards
  palpate robot                                   a simulated UR3e that any UR client can connect to
  palpate view logs/20261122-151233.mcap          look at a session in Rerun"""


def _parser() -> Parser:
    whole = parser("palpate", DESCRIPTION, EXAMPLES)
    whole.add_argument("--version", action="store_true", help="print the version and exit")
    commands = whole.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)
    cells.add_launch(commands)
    cells.add_attend(commands)
    cells.add_snapshot(commands)
    cells.add_curtain(commands)
    cells.add_robot(commands)
    logs.add_replay(commands)
    logs.add_player(commands)
    logs.add_view(commands)
    logs.add_recover(commands)
    log_contents.add_info(commands)
    log_contents.add_export(commands)
    log_contents.add_messages(commands)
    posterior.add_posterior(commands)
    measures.add_experiment(commands)
    cells.add_plugins(commands)
    keys.add_keys(commands)
    cells.add_picture(commands)
    measures.add_bench(commands)
    return whole


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `palpate` command. Returns the exit code."""
    whole = _parser()
    try:
        arguments = whole.parse_args(argv)
    except SystemExit as ending:
        return int(ending.code or 0)
    if arguments.version:
        from importlib.metadata import version

        print(f"palpate {version('palpate')}")  # noqa: T201
        return 0
    if arguments.command is None:
        whole.print_help()
        return 2
    return _run(arguments)


def _run(arguments: argparse.Namespace) -> int:
    signal.signal(signal.SIGTERM, _as_interrupt)
    os.environ.update(ONE_THREAD)  # before anything loads linear algebra
    try:
        module, name = arguments.function.split(":")
        return int(getattr(importlib.import_module(module), name)(arguments))
    except KeyboardInterrupt:
        _complain("interrupted")
        return 130
    except BrokenPipeError:
        # Whoever read our output has gone; nothing more can be said there.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        from runtime.errors import InputError, PalpateError

        if isinstance(error, PalpateError):
            _complain(str(error))
            return 2 if isinstance(error, InputError) else 1
        raise


def _as_interrupt(_number: int, _frame: object) -> NoReturn:
    raise KeyboardInterrupt


def _complain(text: str) -> None:
    print(f"palpate: {' '.join(text.split())}", file=sys.stderr)  # noqa: T201


if __name__ == "__main__":
    sys.exit(main())
