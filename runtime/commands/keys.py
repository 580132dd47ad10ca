"""palpate keys: make the keys with which a cell opens to a network."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from runtime.network.access import ROLES
from runtime.network.keys import CA, DAYS, make_keys


def keys_command(arguments: argparse.Namespace) -> int:
    """Make them and say what is where. Raises InputError rather than overwrite any unasked."""
    folder = Path(arguments.folder)
    days = DAYS if arguments.days is None else arguments.days
    roles = arguments.role or ROLES
    made = make_keys(folder, roles, arguments.host, days, renew=arguments.renew)
    print_ = Console().print
    print_(
        f"{len(made)} certificates and their private keys in {folder}, valid for {days} days: {', '.join(roles)}",
        highlight=False,
        soft_wrap=True,
    )
    print_(f"{folder / CA}.key makes more: keep it from every other machine", highlight=False, soft_wrap=True)
    return 0
