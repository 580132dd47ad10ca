"""Arguments of the commands that run or show a cell."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add, add_meeting_point

LAUNCH = """\
examples:
  palpate launch                                    the igbt cell, as fast as the machine allows
  palpate launch capacitor --strategy spiral        another cell, another strategy
  palpate launch --boards 10 --fresh                forget what was learnt, then ten boards
  palpate launch my-cell.toml --rate 1.0 --rerun spawn   your own cell, in real time, watched live
  palpate launch --attended                         ask a person what to do when a hole is not filled
  palpate launch --boards 500 --split 100MB         a log in several files
  palpate launch --boards 500 --snapshot 30         keep 30 s in memory, write them down when something fails

The log goes to logs/<session>.mcap; what was learnt stays in logs/posterior.sqlite3."""


def add_launch(commands: Commands) -> None:
    """palpate launch."""
    launch = add(
        commands,
        "launch",
        "run a cell: insert boards, record the session",
        LAUNCH,
        "runtime.commands.launch:launch_command",
    )
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
        "--port", type=int, metavar="PORT", help="of the cell's Zenoh router (default: that of the cell, or 7447)"
    )
    launch.add_argument(
        "--logs", default="logs", metavar="DIR", help="where logs and the posterior store go (default: logs)"
    )

    launch.add_argument(
        "--attended",
        action="store_true",
        help="where a hole is not filled, say what is needed, and wait for an answer: here, or by `palpate attend`",
    )
    recording = launch.add_mutually_exclusive_group()
    recording.add_argument(
        "--split",
        metavar="LIMIT",
        help="go on in another file at this size (100MB, 1.5GiB) or after this session time (60s, 10min); "
        "<session>.mcap opens all of them",
    )
    recording.add_argument(
        "--snapshot",
        metavar="SECONDS",
        help="write no log, but keep so much session time in memory, and write it to <session>-snapshot-N.mcap when "
        "`palpate snapshot` asks or something fails: a plugin, an attempt that is aborted, a protective stop, an error",
    )
    launch.add_argument(
        "--in-process",
        action="store_true",
        help="run all plugins as threads of this process, without Zenoh, where a debugger reaches them",
    )


ATTEND = """\
examples:
  palpate attend                                    what does the cell need? on a terminal: answer it
  palpate attend --wait                             wait until it needs something
  palpate attend retry --note "board pushed home"   the same hole again, with a fresh part
  palpate attend skip                               leave this hole, go on with the next
  palpate attend abort                              end the job
  palpate attend retry --cell my-cell.toml          a cell with security, or on another machine

The cell must be attended: `palpate launch --attended`, or in its file [attendance] mode = "attended"."""


def add_attend(commands: Commands) -> None:
    """palpate attend."""
    attend = add(
        commands,
        "attend",
        "see what a running cell needs from a person, and answer it",
        ATTEND,
        "runtime.commands.attend:attend_command",
    )
    attend.add_argument(
        "choice", nargs="?", metavar="ANSWER", help="retry, skip or abort; without: show what is needed"
    )
    attend.add_argument("--note", default="", metavar="TEXT", help="kept in the log with the answer")
    attend.add_argument("--who", metavar="NAME", help="who answers (default: your user name)")
    attend.add_argument("--number", type=int, metavar="N", help="answer request N only (default: the one that is open)")
    attend.add_argument("--wait", action="store_true", help="wait until the cell needs something")
    add_meeting_point(attend, "the cell")


SNAPSHOT = """\
examples:
  palpate snapshot                                  of the cell on the default port
  palpate snapshot --port 7450 --reason "the gripper sounded odd"
  palpate snapshot --cell my-cell.toml              of a cell with security, or on another machine

The cell must have been started with `palpate launch --snapshot SECONDS`."""


def add_snapshot(commands: Commands) -> None:
    """palpate snapshot."""
    snapshot = add(
        commands,
        "snapshot",
        "let a running cell write down what it keeps in memory",
        SNAPSHOT,
        "runtime.commands.snapshot:snapshot_command",
    )
    add_meeting_point(snapshot, "the cell")
    snapshot.add_argument("--reason", default="", metavar="TEXT", help="why; it is kept in the file")


CURTAIN = """\
examples:
  palpate curtain break                             reach in: the arm of the cell on the default port stops
  palpate curtain clear                             step back; the arm still waits for a reset
  palpate curtain reset                             press the reset button: it goes on
  palpate curtain state --port 7450                 only look

It is the simulated curtain of `palpate launch`; run the cell with --rate 1.0 to see it stop when you say so."""


def add_curtain(commands: Commands) -> None:
    """palpate curtain."""
    curtain = add(
        commands,
        "curtain",
        "reach into the simulated light curtain of a running cell",
        CURTAIN,
        "runtime.commands.curtain:curtain_command",
    )
    curtain.add_argument(
        "action",
        choices=("break", "clear", "reset", "state"),
        help="break: interrupt the light field until it is cleared; clear; reset: press and release the reset button; "
        "state: only look",
    )
    add_meeting_point(curtain, "the cell")


ROBOT = """\
examples:
  palpate robot                                     a UR3e over a board of IGBTs, on 127.0.0.1
  palpate robot --scene empty --rerun web           an arm alone, watched in a browser
  palpate robot --scene my-cell.toml --seed 7 --polyscope 5.26
  palpate robot --curtain 7447                      stops when the curtain of `palpate launch` does

Any program written for a UR runs against it, such as ur-rtde's RTDEControlInterface("127.0.0.1").
The ports are UR's own: 29999 dashboard, 30001-30003 scripts, 30004 RTDE.
What is typed works the operator's panel (`help` lists it): estop, safeguard, input, push, ..."""


def add_robot(commands: Commands) -> None:
    """palpate robot."""
    robot = add(
        commands,
        "robot",
        "serve a simulated UR3e on a UR controller's network ports, in real time",
        ROBOT,
        "runtime.commands.robot:robot_command",
    )
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


PLUGINS = """\
examples:
  palpate plugins"""


def add_plugins(commands: Commands) -> None:
    """palpate plugins."""
    add(
        commands,
        "plugins",
        "list what is installed, and what each is for",
        PLUGINS,
        "runtime.commands.plugins:plugins_command",
    )


PICTURE = """\
examples:
  palpate picture capacitor --output capacitor.png"""


def add_picture(commands: Commands) -> None:
    """palpate picture."""
    picture = add(
        commands, "picture", "draw a cell as the simulation has it", PICTURE, "runtime.commands.picture:picture_command"
    )
    picture.add_argument(
        "cell", nargs="?", default="igbt", metavar="CELL", help="a cell file or a shipped name (default: igbt)"
    )
    picture.add_argument("--output", default="cell.png", metavar="FILE", help="a PNG (default: cell.png)")
