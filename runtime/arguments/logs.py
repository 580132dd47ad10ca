"""Arguments of the commands that read recorded logs."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add, add_meeting_point, frequency, moment, seconds

REPLAY = """\
examples:
  palpate replay logs/20261122-151233.mcap                    publish it again with the recorded timing
  palpate replay logs/x.mcap --rate 5 --topics '/attempt' '/search/*'   five times as fast, some topics
  palpate replay logs/x.mcap --start 30 --end 60 --loop       half a minute of it, over and over
  palpate replay logs/x.mcap --wait /joint_states --clock     begin when somebody listens, tell the time on /clock
  palpate replay logs/x.mcap --paused --remap /tf:=/old/tf    begin with a pause, one topic under another name
  palpate replay logs/x.mcap --check                          does today's code decide the same?
  palpate replay logs/x.mcap --what-if bayes,spiral           the same holes with other strategies
keys in a terminal:
  space  pause, resume             left, right  5 s back, on        0, Home  to the start
  s      one message, in a pause   up, down     twice, half the rate   q     end
From elsewhere: palpate player. Times are seconds of session time after the beginning of the log."""


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
    instead = replay.add_mutually_exclusive_group()
    instead.add_argument(
        "--check",
        action="store_true",
        help="publish nothing, but feed what was recorded through today's code and compare every decision",
    )
    instead.add_argument(
        "--what-if",
        metavar="STRATEGY[,STRATEGY]",
        help="publish nothing, but tell how many attempts others would have needed on the holes that the log found",
    )
    replay.add_argument("--rate", default="1.0", metavar="RATE", help="times the recorded speed, or max (default: 1.0)")
    replay.add_argument("--start", type=moment, metavar="S", help="begin there; -S: seconds before the end")
    replay.add_argument("--end", type=moment, metavar="S", help="end before that; -S: seconds before the end")
    replay.add_argument("--loop", action="store_true", help="from the start again at the end, until Ctrl-C")
    replay.add_argument("--paused", action="store_true", help="begin with a pause")
    replay.add_argument(
        "--topics", nargs="+", action="extend", metavar="PATTERN", help="only these topics; * and ? match"
    )
    replay.add_argument("--exclude", nargs="+", action="extend", metavar="PATTERN", help="not these topics")
    replay.add_argument(
        "--remap", nargs="+", action="extend", metavar="OLD:=NEW", help="publish topic OLD as NEW: /tf:=/old/tf"
    )
    replay.add_argument(
        "--clock",
        type=frequency,
        nargs="?",
        const=40.0,
        metavar="HZ",
        help="tell session time on /clock so often a second, instead of the recorded /clock (default: 40)",
    )
    replay.add_argument(
        "--wait",
        nargs="*",
        metavar="PATTERN",
        help="hold the first message until somebody listens to each of these topics; without PATTERN, to any",
    )
    add_meeting_point(replay, "the router")
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


PLAYER = """\
actions:
  pause | resume | toggle      hold the next message back, and go on
  step [N]                     send one message, or N, in a pause
  seek S                       go to S seconds after the beginning of the log
  skip S                       go S seconds on; -S: back
  rate R | scale F             play at R times the recorded speed, or max; at F times the rate it has
  state                        only tell how far it is
  quit                         end
examples:
  palpate player pause                            whatever `palpate replay` plays on the same port
  palpate player seek 42.5
  palpate player rate max --port 7450
A program asks the same of /player/control, with PlayerCommand and PlayerState."""


def add_player(commands: Commands) -> None:
    """palpate player."""
    player = add(
        commands,
        "player",
        "tell a running `palpate replay` to pause, step, seek or play at another rate",
        PLAYER,
        "runtime.commands.player:player_command",
    )
    player.add_argument("action", metavar="ACTION", help="what it is to do, see below")
    player.add_argument("value", metavar="VALUE", nargs="?", help="of the action")
    add_meeting_point(player, "the player")


RECOVER = """\
examples:
  palpate recover logs/20261122-151233.mcap         close the log of a session that was killed
  palpate recover logs/x.mcap --output whole.mcap   leave it alone, write another file

palpate reads a log that was never finished as it is, and so do few other programs. Recovering writes the index and
the end that it lacks; the file as it was stays beside it, with the ending .unfinished."""


def add_recover(commands: Commands) -> None:
    """palpate recover."""
    recover = add(
        commands,
        "recover",
        "close a log that was never finished, as when its recorder was killed",
        RECOVER,
        "runtime.commands.recover:recover_command",
    )
    recover.add_argument("log", metavar="LOG", help="an .mcap file; the first of a session in several files")
    recover.add_argument("--output", metavar="FILE", help="write there instead")


VIEW = """\
examples:
  palpate view logs/20261122-151233.mcap              open it in Rerun's window
  palpate view logs/x.mcap --web                      in a browser, on this machine only
  palpate view logs/x.mcap --save x.rrd               write a file that `rerun x.rrd` opens"""


def add_view(commands: Commands) -> None:
    """palpate view."""
    view = add(commands, "view", "look at a recorded session in Rerun", VIEW, "runtime.commands.view:view_command")
    view.add_argument("log", metavar="LOG", help="an .mcap file")
    where = view.add_mutually_exclusive_group()
    where.add_argument("--web", action="store_true", help="serve it to a browser, on loopback, until Ctrl-C")
    where.add_argument("--save", metavar="FILE", help="write it to an .rrd file, and open nothing")
