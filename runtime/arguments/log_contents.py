"""Arguments of the commands that tell what recorded logs hold, in numbers and tables."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add

INFO = """\
examples:
  palpate info logs/20261122-151233.mcap              what was run, what it holds, what was lost
  palpate info logs/x.mcap --json | jq '.searches[] | select(.outcome != "inserted")'"""


def add_info(commands: Commands) -> None:
    """palpate info."""
    info = add(
        commands,
        "info",
        "tell what a log holds: session, topics, losses, searches and their outcomes, stops, warnings",
        INFO,
        "runtime.commands.info:info_command",
    )
    info.add_argument("log", metavar="LOG", help="an .mcap file, of palpate or of another program")
    info.add_argument("--json", action="store_true", help="print one JSON object, for programs")


EXPORT = """\
examples:
  palpate export logs/20261122-151233.mcap --csv tables            attempts.csv, searches.csv, joints.csv, ...
  palpate export logs/x.mcap --parquet tables --signals wrench,trace    the wrench, and every 500 Hz cycle
  palpate export logs/x.mcap --csv tables --signals none           attempts, searches, permits and stops alone

Columns carry their unit (x_m, force_z_N), times are seconds of the session."""


def add_export(commands: Commands) -> None:
    """palpate export."""
    export = add(
        commands,
        "export",
        "write a log's attempts, searches, permits, stops and signals as tables",
        EXPORT,
        "runtime.commands.export:export_command",
    )
    export.add_argument("log", metavar="LOG", help="an .mcap file")
    export.add_argument("--csv", metavar="DIR", help="write CSV files there; the directory is made")
    export.add_argument("--parquet", metavar="DIR", help="write Parquet files there; the directory is made")
    export.add_argument(
        "--signals",
        default="joints,wrench,tcp",
        metavar="A,B,...",
        help="joints, wrench, tcp, trace (every control cycle), or none (default: joints,wrench,tcp)",
    )
    export.add_argument("--force", action="store_true", help="replace tables that are there already")


MESSAGES = """\
examples:
  palpate messages                               where the ROS 2 package with the .msg files is, and its types
  palpate messages --output ~/ros2_ws/src        copy it into a colcon workspace

Then `colcon build --packages-select palpate_msgs`, and ros2 topic echo knows palpate's own types."""


def add_messages(commands: Commands) -> None:
    """palpate messages."""
    messages = add(
        commands,
        "messages",
        "list palpate's own message types, and copy them as a ROS 2 package",
        MESSAGES,
        "runtime.commands.messages:messages_command",
    )
    messages.add_argument("--output", metavar="DIR", help="write the package palpate_msgs into this directory")
    messages.add_argument("--force", action="store_true", help="replace the files of an earlier palpate_msgs there")
