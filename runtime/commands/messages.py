"""palpate messages: palpate's own message types, and the ROS 2 package that defines them."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.table import Table

from runtime.declaration import declared, type_name
from runtime.ros_package import FOLDER, write
from runtime.topics import topics


def messages_command(arguments: argparse.Namespace) -> int:
    """Print the types and where their package is, or write the package into a workspace."""
    console = Console()
    if arguments.output is not None:
        folder = write(Path(arguments.output).expanduser(), force=arguments.force)
        console.print(
            f"{folder}: {len(declared())} message types\nbuild it with: colcon build --packages-select {folder.name}",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
        return 0
    table = Table(box=None, pad_edge=False)
    for heading in ("type", "topics", "what it says"):
        table.add_column(heading, overflow="fold")
    for name, cls in sorted(declared().items()):
        carried = ", ".join(topic.name for topic in topics().values() if type_name(topic.type) == name)
        table.add_row(name, carried, (cls.__doc__ or "").strip().partition("\n")[0])
    console.print(table)
    console.print(f"their ROS 2 package: {FOLDER}", highlight=False, markup=False, soft_wrap=True)
    return 0
