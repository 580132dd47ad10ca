"""Arguments of the command that makes a cell's keys."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add, days

KEYS = """\
examples:
  palpate keys keys --host 192.168.0.5              for a cell whose router listens there
  palpate keys keys --renew                         new keys for all, from the same authority
  palpate keys keys --renew --role guest            and those of one role alone
Then, in the cell file beside the folder:
  [bus]
  listen = "192.168.0.5"
  security = "mtls"
  keys = "keys"
Another machine joins with a copy of the cell file and, of the folder, ca.pem and one role's .pem and .key: guest
reads, operator also asks for snapshots and leads a player. ca.key makes new keys; it stays where it is."""


def add_keys(commands: Commands) -> None:
    """palpate keys."""
    keys = add(
        commands,
        "keys",
        "make the keys with which a cell opens to a network: a certificate for each role",
        KEYS,
        "runtime.commands.keys:keys_command",
    )
    keys.add_argument("folder", metavar="DIR", help="where they go; the folder is made")
    keys.add_argument(
        "--host",
        action="append",
        default=[],
        metavar="NAME_OR_IP",
        help="by which other machines reach the router; may be repeated. Its own machine always does by localhost",
    )
    keys.add_argument(
        "--role", action="append", metavar="ROLE", help="only this role's; may be repeated (default: every role)"
    )
    keys.add_argument("--days", type=days, metavar="N", help="that they are valid (default: 730)")
    keys.add_argument("--renew", action="store_true", help="replace those that are there")
