"""Runs a cell: one process per plugin, a session from its first permit to its closed log, whatever happens."""

from __future__ import annotations

import json
import os
import platform
import re
import secrets
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from runtime import registry, roles
from runtime.clock import wall_clock
from runtime.config import CellFile, redacted, robot_of, scope_of
from runtime.crew import Crew
from runtime.errors import InputError, SessionError
from runtime.follower import FailedSessionError, Follower, Progress, Session, begin
from runtime.log.split import Split
from runtime.log.writer import SESSION_RECORD, VERSIONS_RECORD
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.roles import Assignment
from runtime.safety.permit_seal import new_key

GRACE = 2.0  # [s] for a plugin that has left the bus to end, and to say why
PACKAGES = ("palpate", "eclipse-zenoh", "mcap", "mujoco", "numpy", "pin", "rerun-sdk", "rosbags", "scipy")
_SUFFIX = re.compile(r"(-snapshot-\d+|\.part\d+)?\.mcap.*")  # what follows a session's name in that of a file


@dataclass(frozen=True)
class Order:
    """What a session shall be."""

    cell_file: CellFile
    logs: Path
    fresh: bool = False
    viewer: str | None = None  # spawn, web or save; None: nobody watches
    split: Split | None = None  # when the log goes on in another file
    snapshot: float | None = None  # [s] of session time that the recorder keeps in memory, instead of writing a log


def launch(order: Order, show: Callable[[Progress], None]) -> Session:
    """Run a session to its end. KeyboardInterrupt ends it early, in the same order, and is told by `interrupted`.

    Raises InputError if it cannot begin, FailedSessionError if a plugin fails.
    """
    return carried_out(order, show, _run)


def carried_out(
    order: Order,
    show: Callable[[Progress], None],
    run: Callable[[Order, Session, Callable[[Progress], None]], None],
) -> Session:
    """Check an order and let `run` carry it out in a new session."""
    check_order(order)
    session = new_session(order.logs)
    try:
        run(order, session, show)
    except SessionError as error:
        raise FailedSessionError(str(error), session) from error
    return session


def _run(order: Order, session: Session, show: Callable[[Progress], None]) -> None:
    cell = order.cell_file.cell
    point = order.cell_file.meeting_point
    with ZenohRouter(point) as router, Crew() as crew:
        try:
            for assignment in assignments(order, session):
                crew.start(assignment)
            failure = begin(lambda: crew.wait_until_ready(router.wait_for))
            with ZenohBus(roles.LAUNCHER, point) as bus:
                follower = Follower(
                    bus, partial(_check, crew, router), session, cell.boards * len(cell.board.holes), show
                )
                follower.see_through(failure, partial(_close, crew, follower))
        except KeyboardInterrupt:
            session.interrupted = True
            crew.close()


def _check(crew: Crew, router: ZenohRouter) -> None:
    """Raise SessionError if a plugin has ended, or has been out of touch: nobody knows what it missed."""
    crew.check()
    if lost := router.lost_touch(crew.roles, GRACE):
        raise SessionError(f"{', '.join(sorted(lost))}: stood still for too long, or lost the connection to the cell")


def _close(crew: Crew, follower: Follower) -> None:
    try:
        crew.close(all_but=roles.RECORDER)
    finally:
        follower.count()
        crew.close()


def check_order(order: Order) -> None:
    """Let the robot's driver say whether it can do what the cell asks. Raises InputError for what cannot be begun."""
    cell_file = order.cell_file
    cell = cell_file.cell
    check = getattr(robot_of(cell, cell_file.name), "check", None)
    if check is not None:
        check(cell, cell_file.name)
    shared = cell.posterior.shared_through
    if shared and order.fresh:
        raise InputError(
            f"{cell_file.name} shares its evidence, so --fresh would make every cell forget; leave out posterior.share "
            f"to begin anew alone, or let all forget with 'palpate posterior forget {cell.board.type}'"
        )
    if cell_file.sharing_keys is not None and any(endpoint.startswith("tls/") for endpoint in shared):
        from runtime.network.keys import credentials

        credentials(cell_file.sharing_keys, roles.POSTERIOR)


def new_session(logs: Path) -> Session:
    """A session with a name of its own in the folder of logs. Raises InputError if that cannot be written."""
    try:
        logs.mkdir(parents=True, exist_ok=True)
        if not os.access(logs, os.W_OK):
            raise PermissionError("not writable")
    except OSError as error:
        raise InputError(f"logs cannot be written to {logs}: {error.strerror or error}; choose --logs DIR") from None
    taken = {_SUFFIX.sub("", path.name) for path in logs.glob("*.mcap*")}
    unused = next(candidate for candidate in _numbered(wall_clock()) if candidate not in taken)
    return Session(unused, logs / f"{unused}.mcap")


def _numbered(name: str) -> Iterator[str]:
    yield name
    count = 2
    while True:
        yield f"{name}-{count}"
        count += 1


def assignments(order: Order, session: Session) -> Iterator[Assignment]:
    """What each plugin of a session is told."""
    cell = order.cell_file.cell
    document, point = order.cell_file.document, order.cell_file.meeting_point
    simulated = getattr(robot_of(cell, order.cell_file.name), "simulated", False)
    scope = scope_of(document) if simulated else "real"
    document = {**document, "posterior": {**document.get("posterior", {}), "scope": scope}}
    identity = f"{session.name}-{secrets.token_hex(4)}"  # cells that share evidence may begin in the same second
    keys = order.cell_file.sharing_keys
    store = cell.posterior.path or str(order.logs / "posterior.sqlite3")
    options: dict[str, dict[str, Any]] = {
        roles.POSTERIOR: {
            "path": store,
            "session": identity,
            "fresh": order.fresh,
            "keys": "" if keys is None else str(keys.resolve()),
        },
        roles.RECORDER: {
            "path": str(session.log),
            "metadata": _metadata(order, session, identity),
            "attachments": {order.cell_file.name: order.cell_file.text},
            "split": None if order.split is None else asdict(order.split),
            "snapshot": order.snapshot,
        },
    }
    crew = [role for role in roles.CLOSING_ORDER if role != roles.VIEWER]
    if order.viewer is not None:
        crew.append(roles.VIEWER)
        options[roles.VIEWER] = {
            "mode": order.viewer,
            "path": str(session.log.with_suffix(".rrd")) if order.viewer == "save" else "",
        }
    seal_key = new_key().hex()
    for role in crew:
        yield Assignment(
            role=role,
            session=session.name,
            document=redacted(document, role),
            where=order.cell_file.name,
            port=point.port,
            domain=point.domain,
            options=options.get(role, {}),
            host=point.host,
            keys="" if point.keys is None else str(point.keys.resolve()),
            seal_key=seal_key if role in roles.HOLD_SEAL_KEY else "",
        )


def _metadata(order: Order, session: Session, identity: str) -> dict[str, dict[str, str]]:
    cell = order.cell_file.cell
    versions = {package: version(package) for package in PACKAGES}
    versions |= registry.packages([(registry.DRIVERS, cell.robot), (registry.STRATEGIES, cell.strategy)])
    return {
        SESSION_RECORD: {
            "session": session.name,
            "evidence_session": identity,
            "cell": order.cell_file.name,
            "robot": cell.robot,
            "strategy": cell.strategy,
            "component": cell.component,
            "board_type": cell.board.type,
            "boards": str(cell.boards),
            "seed": str(cell.seed),
            "rate": cell.rate,
            "settings": json.dumps(order.cell_file.document),
        },
        VERSIONS_RECORD: {**versions, "python": platform.python_version(), "system": platform.system()},
    }
