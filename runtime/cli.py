"""The command line: palpate launch | robot | replay | view | experiment | plugins | picture | bench.

Only the standard library is imported here; each command imports what it needs.
Exit codes: 0 done, 1 the job failed, 2 the input is wrong, 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

Command = Callable[[argparse.Namespace], int]

DESCRIPTION = """\
palpate finds the hole by touch: a robot cell that inserts through-hole parts into circuit
boards without a camera, learns where the holes really are, and records all of it."""

EXAMPLES = {
    "palpate": """\
examples:
  palpate launch                                  nine IGBTs into one board, meta search, simulated UR3e
  palpate launch --strategy spiral --boards 3     another strategy, three boards
  palpate robot                                   a simulated UR3e that any UR client can connect to
  palpate view logs/20261122-151233.mcap          look at a session in Rerun""",
    "launch": """\
examples:
  palpate launch                                    the igbt cell, as fast as the machine allows
  palpate launch capacitor --strategy spiral        another cell, another strategy
  palpate launch --boards 10 --fresh                forget what was learnt, then ten boards
  palpate launch my-cell.toml --rate 1.0 --rerun spawn   your own cell, in real time, watched live

The log goes to logs/<session>.mcap; what was learnt stays in logs/posterior.sqlite3.""",
    "robot": """\
examples:
  palpate robot                                     a UR3e over a board of IGBTs, on 127.0.0.1
  palpate robot --scene empty --rerun web           an arm alone, watched in a browser
  palpate robot --scene my-cell.toml --seed 7 --polyscope 5.26
  palpate robot --curtain 7447                      stops when the curtain of `palpate launch` does

Any program written for a UR runs against it, such as ur-rtde's RTDEControlInterface("127.0.0.1").
The ports are UR's own: 29999 dashboard, 30001-30003 scripts, 30004 RTDE.
What is typed works the operator's panel (`help` lists it): estop, safeguard, input, push, ...""",
    "replay": """\
examples:
  palpate replay logs/20261122-151233.mcap                    publish it again with the recorded timing
  palpate replay logs/x.mcap --rate 5 --topics '/attempt' '/search/*'   five times as fast, some topics""",
    "view": """\
examples:
  palpate view logs/20261122-151233.mcap                       open it in Rerun
  palpate view logs/x.mcap --rerun web                         in a browser
  palpate view logs/x.mcap --rerun save --output x.rrd         write a file that `rerun x.rrd` opens""",
    "experiment": """\
examples:
  palpate experiment                                           what can be tried
  palpate experiment compare                                   every strategy in every world, on the statistical model
  palpate experiment compare --seeds 20 --strategies meta,bayes --worlds realistic
  palpate experiment compare --physics --seeds 3 --out out     in full MuJoCo physics
  palpate experiment robustness --executor dask://node1:8786   on a dask cluster

Results are kept in the user's cache: a run that was stopped goes on where it was, and what has not changed
is not computed again. Tables (CSV, Markdown) and figures (PNG, SVG) go to experiments/NAME or --out DIR.""",
    "plugins": """\
examples:
  palpate plugins""",
    "picture": """\
examples:
  palpate picture capacitor --output capacitor.png""",
    "bench": """\
examples:
  palpate bench sim                               real-time factors of physics, controller and whole cell
  palpate bench sim --cell capacitor --json figures.json
  palpate bench robot --seconds 20                packages on time, round trips, late cycles
  palpate bench plan --strategy bayes,meta        milliseconds of thought before each candidate""",
}


class _Parser(argparse.ArgumentParser):
    """Errors in one line, with exit code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"palpate: {message}; see '{self.prog} --help'\n")


def _parser() -> argparse.ArgumentParser:
    parser = _make(None, "palpate", DESCRIPTION)
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_Parser)

    launch = _make(commands, "launch", "run a cell: insert boards, record the session")
    launch.add_argument(
        "cell",
        nargs="?",
        default="igbt",
        metavar="CELL",
        help="a cell file, or the name of one that ships with palpate (default: igbt)",
    )
    launch.add_argument("--strategy", metavar="NAME", help="meta, linear, spiral, hybrid, or another that is installed")
    launch.add_argument("--component", metavar="NAME", help="igbt or capacitor")
    launch.add_argument("--boards", type=int, metavar="N", help="how many boards to work through")
    launch.add_argument("--seed", type=int, metavar="S", help="of the simulated world and of every random draw")
    launch.add_argument("--rate", metavar="RATE", help="max, or session seconds per second: 1.0 is real time")
    launch.add_argument(
        "--rerun",
        choices=("auto", "spawn", "web", "save", "off"),
        default="auto",
        help="watch live in Rerun: in a window, in a browser, or saved to a file; auto: a window if there is a display",
    )
    launch.add_argument("--fresh", action="store_true", help="forget what was learnt of this board type before")
    launch.add_argument(
        "--port", type=int, metavar="PORT", help="of the cell's Zenoh router on loopback (default: 7447)"
    )
    launch.add_argument(
        "--logs", default="logs", metavar="DIR", help="where logs and the posterior store go (default: logs)"
    )

    launch.add_argument(
        "--in-process",
        action="store_true",
        help="run all plugins as threads of this process, without Zenoh, where a debugger reaches them",
    )

    robot = _make(commands, "robot", "serve a simulated UR3e on a UR controller's network ports, in real time")
    robot.add_argument(
        "--scene",
        default="igbt",
        metavar="CELL",
        help="igbt, capacitor, empty (an arm alone) or a cell file (default: igbt)",
    )
    robot.add_argument("--host", default="127.0.0.1", metavar="IP", help="address to listen on (default: 127.0.0.1)")
    robot.add_argument("--seed", type=int, metavar="S", help="of the simulated world, instead of the cell's own")
    robot.add_argument(
        "--polyscope", default="5.22", metavar="VERSION", help="version to report, 5.10 to 5.26 (default: 5.22)"
    )
    robot.add_argument("--programs", metavar="DIR", help="folder of .script files that the dashboard can load")
    robot.add_argument(
        "--rerun",
        choices=("auto", "spawn", "web", "save", "off"),
        default="auto",
        help="follow the arm in Rerun: in a window, in a browser, or saved to robot.rrd; auto: a window if possible",
    )
    robot.add_argument(
        "--port", type=int, default=7448, metavar="PORT", help="of the viewer's Zenoh router (default: 7448)"
    )
    robot.add_argument(
        "--curtain",
        type=int,
        metavar="PORT",
        help="wire the light curtain of the cell whose Zenoh router is on this port to the safeguard input",
    )

    replay = _make(commands, "replay", "publish a recorded session on Zenoh again, with its timing")
    replay.add_argument("log", metavar="LOG", help="an .mcap file")
    replay.add_argument("--rate", default="1.0", metavar="RATE", help="times the recorded speed, or max (default: 1.0)")
    replay.add_argument(
        "--topics", nargs="+", metavar="PATTERN", default=["*"], help="only these topics; * and ? match"
    )
    replay.add_argument(
        "--port",
        type=int,
        default=7447,
        metavar="PORT",
        help="of the Zenoh router (default: 7447)",
    )

    replay.add_argument(
        "--join", action="store_true", help="join the router that runs on the port, instead of starting one"
    )
    replay.add_argument(
        "--delay",
        type=_seconds,
        default=0.0,
        metavar="S",
        help="seconds to wait for subscribers before the first message (default: 0)",
    )

    view = _make(commands, "view", "look at a recorded session in Rerun")
    view.add_argument("log", metavar="LOG", help="an .mcap file")
    view.add_argument(
        "--rerun",
        choices=("spawn", "web", "save"),
        default="spawn",
        help="a window, a browser, or a file (default: spawn)",
    )
    view.add_argument(
        "--output", metavar="FILE", help="where save writes (default: beside the log, with the ending .rrd)"
    )

    _add_experiment(commands)

    _make(commands, "plugins", "list what is installed, and what each is for")

    picture = _make(commands, "picture", "draw a cell as the simulation has it")
    picture.add_argument(
        "cell", nargs="?", default="igbt", metavar="CELL", help="a cell file or a shipped name (default: igbt)"
    )
    picture.add_argument("--output", default="cell.png", metavar="FILE", help="a PNG (default: cell.png)")

    bench = _make(commands, "bench", "measure on this machine")
    bench.add_argument(
        "what",
        choices=("sim", "robot", "plan"),
        help="sim: real-time factors of physics, controller and whole cell; "
        "robot: how punctual the simulated controller is for two clients on the network; "
        "plan: how long strategies think before each candidate",
    )
    bench.add_argument(
        "--seconds", type=_seconds, default=60.0, metavar="S", help="robot: how long to measure (default: 60)"
    )
    bench.add_argument("--cell", default="igbt", metavar="CELL", help="a cell file or a shipped name (default: igbt)")
    bench.add_argument("--strategy", metavar="NAME", help="instead of the cell's own; plan: one or more, with commas")
    bench.add_argument("--seed", type=int, metavar="S", help="instead of the cell's own")
    bench.add_argument("--port", type=int, metavar="PORT", help="of the cell's Zenoh router (default: 7447)")
    bench.add_argument("--json", metavar="FILE", help="write the figures there as name: number")
    return parser


def _add_experiment(commands: argparse._SubParsersAction[_Parser]) -> None:
    experiment = _make(commands, "experiment", "compare strategies over many simulated worlds")
    experiment.add_argument(
        "name", nargs="?", default="list", metavar="NAME", help="of the experiment; list tells what there is (default)"
    )
    experiment.add_argument("--seeds", type=int, metavar="N", help="worlds to draw (default: the experiment's own)")
    experiment.add_argument("--boards", type=int, metavar="N", help="boards to work through in each (default: 10)")
    experiment.add_argument(
        "--physics",
        action="store_true",
        help="in full MuJoCo physics instead of the statistical model; a tenth of the seeds unless --seeds says more",
    )
    experiment.add_argument("--strategies", metavar="A,B,...", help="instead of the experiment's own")
    experiment.add_argument("--worlds", metavar="A,B,...", help="instead of the experiment's own")
    experiment.add_argument("--components", metavar="A,B,...", help="igbt, capacitor")
    experiment.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one for each core)")
    experiment.add_argument(
        "--executor",
        default="joblib",
        metavar="E",
        help="joblib: this machine (default); dask://HOST:PORT or ray://HOST:PORT: a cluster",
    )
    experiment.add_argument("--out", metavar="DIR", help="where tables and figures go (default: experiments/NAME)")
    experiment.add_argument(
        "--cache", metavar="DIR", help="where results are kept (default: palpate in the user's cache directory)"
    )


def _seconds(text: str) -> float:
    value = float(text)
    if not 0 <= value <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is no number of seconds from 0 to 3600")
    return value


def _make(commands: argparse._SubParsersAction[_Parser] | None, name: str, text: str) -> argparse.ArgumentParser:
    if commands is None:
        return _Parser(
            prog=name, description=text, epilog=EXAMPLES[name], formatter_class=argparse.RawDescriptionHelpFormatter
        )
    return commands.add_parser(
        name,
        help=text,
        description=text[:1].upper() + text[1:] + ".",
        epilog=EXAMPLES[name],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _launch(arguments: argparse.Namespace) -> int:
    from runtime.commands.launch import launch_command

    return launch_command(arguments)


def _robot(arguments: argparse.Namespace) -> int:
    from runtime.commands.robot import robot_command

    return robot_command(arguments)


def _replay(arguments: argparse.Namespace) -> int:
    from runtime.commands.replay import replay_command

    return replay_command(arguments)


def _view(arguments: argparse.Namespace) -> int:
    from runtime.commands.view import view_command

    return view_command(arguments)


def _experiment(arguments: argparse.Namespace) -> int:
    from runtime.commands.experiment import experiment_command

    return experiment_command(arguments)


def _plugins(arguments: argparse.Namespace) -> int:
    from runtime.commands.plugins import plugins_command

    return plugins_command(arguments)


def _picture(arguments: argparse.Namespace) -> int:
    from runtime.commands.picture import picture_command

    return picture_command(arguments)


def _bench(arguments: argparse.Namespace) -> int:
    from runtime.commands.bench import bench_command

    return bench_command(arguments)


COMMANDS: dict[str, Command] = {
    "launch": _launch,
    "robot": _robot,
    "replay": _replay,
    "view": _view,
    "experiment": _experiment,
    "plugins": _plugins,
    "picture": _picture,
    "bench": _bench,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the `palpate` command. Returns the exit code."""
    parser = _parser()
    try:
        arguments = parser.parse_args(argv)
    except SystemExit as ending:
        return int(ending.code or 0)
    if arguments.version:
        from importlib.metadata import version

        print(f"palpate {version('palpate')}")  # noqa: T201
        return 0
    if arguments.command is None:
        parser.print_help()
        return 2
    return _run(COMMANDS[arguments.command], arguments)


def _run(command: Command, arguments: argparse.Namespace) -> int:
    signal.signal(signal.SIGTERM, _as_interrupt)
    try:
        return command(arguments)
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
