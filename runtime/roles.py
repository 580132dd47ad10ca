"""Which plugin plays which part in a cell, and what each one is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from runtime import registry
from runtime.config import Cell, robot_of
from runtime.errors import PluginError
from runtime.network.meeting_point import LOOPBACK, MeetingPoint
from runtime.plugin import Driver

ARM = "arm"
CURTAIN = "light_curtain"
INTERLOCK = "interlock"
STRATEGY = "strategy"
POSTERIOR = "posterior"
ASSEMBLY = "assembly"
RECORDER = "recorder"
VIEWER = "viewer"
LAUNCHER = "launcher"

HOLD_SEAL_KEY = frozenset({INTERLOCK, ARM})  # who can seal a permit, and tell whether one is genuine

# In this order they are asked to end: those that ask for work first, the recorder after everything it records.
CLOSING_ORDER = (ASSEMBLY, STRATEGY, ARM, CURTAIN, INTERLOCK, POSTERIOR, VIEWER, RECORDER)


@dataclass(frozen=True)
class Assignment:
    """What one process is told on its standard input."""

    role: str
    session: str
    document: dict[str, Any]  # the cell file as this role may know it
    where: str  # name of the cell file, for errors
    port: int
    domain: int
    options: dict[str, Any] = field(default_factory=dict)  # for recorder, viewer and posterior
    host: str = LOOPBACK  # of the router
    keys: str = ""  # folder of keys; empty: a cell without TLS
    seal_key: str = field(default="", repr=False)  # hexadecimal, for interlock and arm: of the permits' seals

    @property
    def meeting_point(self) -> MeetingPoint:
        """Where the plugin finds the others."""
        return MeetingPoint(self.port, self.domain, (self.host,), Path(self.keys) if self.keys else None)


def make(role: str, cell: Cell, where: str, options: dict[str, Any]) -> Driver:
    """The plugin that plays a role. What it needs is imported here, in its own process."""
    if role == ARM:
        return robot_of(cell, where)
    if role == CURTAIN:
        return registry.driver(CURTAIN, cell.drivers.get(CURTAIN, {}), where)
    if role == INTERLOCK:
        from runtime.safety.plugin import InterlockPlugin

        return InterlockPlugin()
    if role == STRATEGY:
        from runtime.strategy_host import StrategyHost

        return StrategyHost()
    if role == ASSEMBLY:
        from runtime.assembly import Assembly

        return Assembly()
    if role == POSTERIOR:
        from runtime.posterior import Posterior

        return Posterior(
            path=Path(options["path"]),
            session=options["session"],
            fresh=options["fresh"],
            keys=Path(options["keys"]) if options["keys"] else None,
        )
    if role == RECORDER:
        from runtime.log.split import Split
        from runtime.recorder import Recorder

        split = options.get("split")
        return Recorder(
            path=Path(options["path"]),
            metadata=options["metadata"],
            attachments=options["attachments"],
            split=None if split is None else Split(**split),
            snapshot=options.get("snapshot"),
        )
    if role == VIEWER:
        from runtime.viewer import Viewer

        return Viewer(mode=options["mode"], path=options["path"])
    raise PluginError(f"no plugin plays the role {role!r}; known: {', '.join(CLOSING_ORDER)}")
