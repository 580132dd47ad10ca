"""Arguments of the commands that read recorded logs."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add, seconds

REPLAY = """\
examples:
  palpate replay logs/20261122-151233.mcap                    publish it again with the recorded timing
  palpate replay logs/x.mcap --rate 5 --topics '/attempt' '/search/*'   five times as fast, some topics"""


def add_replay(commands: Commands) -> None:
    """palpate replay."""
    replay = add(
        commands,
        "replay",
        "publish a recorded session on Zenoh again, with its timing",
        REPLAY,
        "runtime.commands.replay:replay_command",
    )
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
        type=seconds,
        default=0.0,
        metavar="S",
        help="seconds to wait for subscribers before the first message (default: 0)",
    )


VIEW = """\
examples:
  palpate view logs/20261122-151233.mcap                       open it in Rerun
  palpate view logs/x.mcap --rerun web                         in a browser
  palpate view logs/x.mcap --rerun save --output x.rrd         write a file that `rerun x.rrd` opens"""


def add_view(commands: Commands) -> None:
    """palpate view."""
    view = add(commands, "view", "look at a recorded session in Rerun", VIEW, "runtime.commands.view:view_command")
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
