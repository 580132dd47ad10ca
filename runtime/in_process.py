"""A whole cell in one process, a thread per plugin: for sweeps, for debugging, to show that nothing depends on it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from runtime import roles
from runtime.config import cell_of
from runtime.context import Context
from runtime.errors import SessionError
from runtime.follower import Follower, Progress, Session, begin
from runtime.host import run
from runtime.launcher import Order, assignments, carried_out
from runtime.local_bus import LocalBus, LocalExchange
from runtime.roles import Assignment

CLOSE_TIMEOUT = 20.0  # [s]


@dataclass
class _Worker:
    """A plugin's thread."""

    assignment: Assignment
    context: Context
    failure: list[BaseException] = field(default_factory=list)
    thread: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        self.thread = threading.Thread(target=self._run, name=self.assignment.role, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        try:
            run(self.assignment, self.context)
        except BaseException as error:
            self.failure.append(error)

    def end(self) -> None:
        self.context.stop()
        self.thread.join(CLOSE_TIMEOUT)
        if self.thread.is_alive():
            raise SessionError(f"{self.assignment.role}: did not end within {CLOSE_TIMEOUT:g} s")
        if self.assignment.role == roles.RECORDER:
            self.check()

    def check(self) -> None:
        """Raise SessionError if the plugin failed."""
        if self.failure:
            raise SessionError(f"{self.assignment.role}: {self.failure[0]}") from self.failure[0]


def _close(workers: dict[str, _Worker], follower: Follower) -> None:
    for role in roles.CLOSING_ORDER:
        if role == roles.RECORDER:
            follower.count()
        if role in workers:
            workers.pop(role).end()


def run_in_process(order: Order, show: Callable[[Progress], None] = lambda _progress: None) -> Session:
    """Like `launcher.launch`, on a bus within this process."""
    return carried_out(order, show, _run)


def _run(order: Order, session: Session, show: Callable[[Progress], None]) -> None:
    cell = order.cell_file.cell
    exchange = LocalExchange()
    workers: dict[str, _Worker] = {}

    def check() -> None:
        for role, worker in workers.items():
            worker.check()
            if not worker.thread.is_alive():
                raise SessionError(f"{role}: ended before the session did")

    def wait_until_ready() -> None:
        while exchange.wait_for(set(workers), 0.2):
            check()

    try:
        for assignment in assignments(order, session):
            bus = LocalBus(exchange, assignment.role)
            cell_told = cell_of(assignment.document, assignment.where)
            key = bytes.fromhex(assignment.seal_key)
            context = Context(assignment.role, bus, cell_told, session.name, key)
            workers[assignment.role] = _Worker(assignment, context)
        failure = begin(wait_until_ready)
        with LocalBus(exchange, roles.LAUNCHER) as bus:
            follower = Follower(bus, check, session, cell.boards * len(cell.board.holes), show)
            follower.see_through(failure, partial(_close, workers, follower))
    finally:
        for worker in workers.values():
            worker.context.stop()
