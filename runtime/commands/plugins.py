"""palpate plugins: what is installed, and what each is for."""

from __future__ import annotations

import argparse

from rich.console import Console
from rich.table import Table

from runtime.registry import DRIVERS, installed

KINDS = {DRIVERS: "driver"}


def plugins_command(_arguments: argparse.Namespace) -> int:
    """Print a table of the installed plugins. 1 if one of them cannot be loaded."""
    found = installed()
    table = Table(box=None, pad_edge=False)
    for heading in ("name", "kind", "package", "what it is for"):
        table.add_column(heading, overflow="fold")
    for plugin in found:
        summary = f"cannot be loaded: {plugin.broken}" if plugin.broken else plugin.summary
        table.add_row(plugin.name, KINDS.get(plugin.group, "strategy"), plugin.package, summary)
    Console().print(table)
    return 1 if any(plugin.broken for plugin in found) else 0
