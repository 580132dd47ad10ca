"""Arguments of `palpate posterior`, which looks after what was learnt."""

from __future__ import annotations

from runtime.arguments.parser import Commands, Parser, add

POSTERIOR = """\
examples:
  palpate posterior list                            what has been learnt, of which boards
  palpate posterior show inverter-9                 where its holes are believed to be
  palpate posterior export holes.json               take it to another cell
  palpate posterior import holes.json --store line2/posterior.sqlite3
  palpate posterior forget inverter-9               begin anew
  palpate posterior serve                           let cells share it

The store is logs/posterior.sqlite3 unless --store or --logs says otherwise. A cell may be running."""

LIST = """\
examples:
  palpate posterior list
  palpate posterior list --store line2/posterior.sqlite3

What was forgotten is kept but counts no more; the last column counts it apart."""

SHOW = """\
examples:
  palpate posterior show inverter-9
  palpate posterior show inverter-9 --component igbt --hole 7
  palpate posterior show inverter-9 --picture holes.png

Offsets are from the nominal hole, for the next part in a new board, as a search starts from them."""

EXPORT = """\
examples:
  palpate posterior export holes.json                    all of it, to import elsewhere
  palpate posterior export attempts.csv --board-type inverter-9
  palpate posterior export | head -1                     JSON lines, one search each

Times are nanoseconds since 1970, lengths are metres. CSV has a row for each attempt; it cannot be imported."""

IMPORT = """\
examples:
  palpate posterior import holes.json
  palpate posterior export --store line2/posterior.sqlite3 | palpate posterior import -

What the store has already is not counted again, and what was forgotten here stays forgotten.
If anything in the file is wrong, nothing of it is imported."""

FORGET = """\
examples:
  palpate posterior forget inverter-9
  palpate posterior forget inverter-9 --scope real --yes
  palpate posterior forget inverter-9 --undo             let it count again

What is forgotten stays in the file but counts no more, nor does a copy of it that another cell or an import brings.
Cells that share their evidence forget it together, and recall it together."""

SERVE = """\
examples:
  palpate posterior serve --store shared.sqlite3                       for cells on this machine
  palpate posterior serve --listen tls/0.0.0.0:7460 --keys keys        for a network

In the file of each cell, with the address by which it reaches this machine:
  [posterior]
  share = "tls/192.168.0.2:7460"
  keys = "keys"
Every cell keeps a store of its own and works on when nobody answers here; afterwards each catches up with all others.
This store keeps what they found, so that it also reaches cells that never run at the same time. It can be looked at
meanwhile. The cells' keys, posterior.pem and posterior.key, and the router.pem and router.key of this machine, come
from one `palpate keys`."""

_SCOPE = "only evidence of this world, as `palpate posterior list` names it"


def add_posterior(commands: Commands) -> None:
    """palpate posterior."""
    text = "look at what was learnt about the holes; take it elsewhere; forget it"
    posterior = add(commands, "posterior", text, POSTERIOR, "")
    actions = posterior.add_subparsers(dest="action", metavar="ACTION", parser_class=Parser, required=True)
    _add_list(actions)
    _add_show(actions)
    _add_export(actions)
    _add_import(actions)
    _add_forget(actions)
    _add_serve(actions)


def _add(actions: Commands, name: str, text: str, examples: str) -> Parser:
    action = add(actions, name, text, examples, f"runtime.commands.posterior:{name}_command")
    action.add_argument("--store", metavar="FILE", help="the store (default: posterior.sqlite3 in the folder of logs)")
    action.add_argument("--logs", default="logs", metavar="DIR", help="folder of logs (default: logs)")
    return action


def _add_list(actions: Commands) -> None:
    _add(actions, "list", "list what was learnt, by board type, component and scope", LIST)


def _add_show(actions: Commands) -> None:
    show = _add(actions, "show", "show where the holes of a board type are believed to be", SHOW)
    show.add_argument("board_type", metavar="BOARD_TYPE", help="as `palpate posterior list` names it")
    show.add_argument("--component", metavar="NAME", help="only this component")
    show.add_argument("--scope", metavar="SCOPE", help=_SCOPE)
    show.add_argument("--hole", metavar="NAME", help="only this hole")
    show.add_argument(
        "--prior-width",
        type=float,
        default=0.5,
        metavar="MM",
        help="standard deviation believed before anything is known, as the cell has it (default: 0.5)",
    )
    show.add_argument("--picture", metavar="FILE", help="draw the holes' ellipses into a PNG or SVG, too")


def _add_export(actions: Commands) -> None:
    export = _add(actions, "export", "write evidence to a file, or as JSON lines", EXPORT)
    export.add_argument(
        "file", nargs="?", metavar="FILE", help=".json, .jsonl or .csv (default: JSON lines to standard output)"
    )
    export.add_argument("--board-type", metavar="NAME", help="only this board type")
    export.add_argument("--component", metavar="NAME", help="only this component")
    export.add_argument("--scope", metavar="SCOPE", help=_SCOPE)
    export.add_argument(
        "--forgotten", action="store_true", help="also what was forgotten, so that whoever imports it forgets it, too"
    )


def _add_import(actions: Commands) -> None:
    import_ = _add(actions, "import", "add the evidence of a file that `palpate posterior export` wrote", IMPORT)
    import_.add_argument("file", metavar="FILE", help=".json or .jsonl; - reads standard input")


def _add_forget(actions: Commands) -> None:
    forget = _add(actions, "forget", "let evidence count no more", FORGET)
    forget.add_argument("board_type", nargs="?", metavar="BOARD_TYPE", help="as `palpate posterior list` names it")
    forget.add_argument("--all", action="store_true", help="every board type")
    forget.add_argument("--scope", metavar="SCOPE", help=_SCOPE)
    forget.add_argument("--yes", action="store_true", help="do not ask")
    forget.add_argument("--undo", action="store_true", help="let what was forgotten count again")


def _add_serve(actions: Commands) -> None:
    serve = _add(actions, "serve", "let cells share what they learn: they meet here", SERVE)
    serve.add_argument(
        "--listen",
        action="append",
        metavar="ADDRESS",
        help="tcp/HOST:PORT or tls/HOST:PORT; may be repeated (default: tcp/127.0.0.1:7460, this machine alone)",
    )
    serve.add_argument("--keys", metavar="DIR", help="folder that `palpate keys` made, for tls/")
