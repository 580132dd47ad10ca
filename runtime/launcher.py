"""Runs a cell: one process per plugin, a session from its first permit to its closed log, whatever happens."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from runtime import roles
from runtime.clock import wall_clock
from runtime.config import CellFile, redacted, robot_of, scope_of
from runtime.crew import Crew
from runtime.errors import InputError
from runtime.follower import Follower, Progress, Session
from runtime.roles import Assignment
from runtime.zenoh_bus import ZenohBus, ZenohRouter

PACKAGES = ("palpate", "eclipse-zenoh", "mcap", "mujoco", "numpy", "pin", "rerun-sdk", "rosbags", "scipy")


@dataclass(frozen=True)
class Order:
    """What a session shall be."""

    cell_file: CellFile
    logs: Path
    fresh: bool = False
    viewer: str | None = None  # spawn, web or save; None: nobody watches


def launch(order: Order, show: Callable[[Progress], None]) -> Session:
    """Run a session to its end. KeyboardInterrupt ends it early, in the same order, and is told by `interrupted`.

    Raises InputError if it cannot begin, SessionError if a plugin fails or messages were lost.
    """
    cell_file = order.cell_file
    cell = cell_file.cell
    check_cell(cell_file)
    session = new_session(order.logs)
    with ZenohRouter(cell.bus.port, cell.bus.domain) as router, Crew() as crew:
        try:
            for assignment in assignments(order, session):
                crew.start(assignment)
            crew.wait_until_ready(router.wait_for)
            with ZenohBus(roles.LAUNCHER, cell.bus.port, cell.bus.domain) as bus:
                follower = Follower(bus, crew.check, session, cell.boards * len(cell.board.holes), show)
                try:
                    follower.follow()
                finally:
                    crew.close(all_but=roles.RECORDER)
                    follower.count()
                    crew.close()
        except KeyboardInterrupt:
            session.interrupted = True
            crew.close()
    return session


def check_cell(cell_file: CellFile) -> None:
    """Let the robot's driver say whether it can do what the cell asks. Raises CellError."""
    cell = cell_file.cell
    check = getattr(robot_of(cell, cell_file.name), "check", None)
    if check is not None:
        check(cell, cell_file.name)


def new_session(logs: Path) -> Session:
    """A session with a name of its own in the folder of logs. Raises InputError if that cannot be written."""
    try:
        logs.mkdir(parents=True, exist_ok=True)
        if not os.access(logs, os.W_OK):
            raise PermissionError("not writable")
    except OSError as error:
        raise InputError(f"logs cannot be written to {logs}: {error.strerror or error}; choose --logs DIR") from None
    name = wall_clock()
    taken = {path.stem for path in logs.glob("*.mcap")}
    unused = next(candidate for candidate in _numbered(name) if candidate not in taken)
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
    document = order.cell_file.document
    simulated = getattr(robot_of(cell, order.cell_file.name), "simulated", False)
    scope = scope_of(document) if simulated else "real"
    document = {**document, "posterior": {**document.get("posterior", {}), "scope": scope}}
    store = cell.posterior.path or str(order.logs / "posterior.sqlite3")
    options: dict[str, dict[str, Any]] = {
        roles.POSTERIOR: {"path": store, "fresh": order.fresh},
        roles.RECORDER: {
            "path": str(session.log),
            "metadata": _metadata(order, session),
            "attachments": {order.cell_file.name: order.cell_file.text},
        },
    }
    crew = [role for role in roles.CLOSING_ORDER if role != roles.VIEWER]
    if order.viewer is not None:
        crew.append(roles.VIEWER)
        options[roles.VIEWER] = {
            "mode": order.viewer,
            "path": str(session.log.with_suffix(".rrd")) if order.viewer == "save" else "",
        }
    for role in crew:
        yield Assignment(
            role=role,
            session=session.name,
            document=redacted(document, role),
            where=order.cell_file.name,
            port=cell.bus.port,
            domain=cell.bus.domain,
            options=options.get(role, {}),
        )


def _metadata(order: Order, session: Session) -> dict[str, dict[str, str]]:
    cell = order.cell_file.cell
    versions = {package: version(package) for package in PACKAGES}
    return {
        "palpate.session": {
            "session": session.name,
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
        "palpate.versions": {**versions, "python": platform.python_version(), "system": platform.system()},
    }
