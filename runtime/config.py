"""The cell file (TOML) as typed, validated values. Cell files that ship with palpate are found by their bare name.

robot = "mujoco_ur3e"      # a driver
strategy = "meta"
component = "igbt"

[board]
type = "inverter-9"
holes = [{ name = "1", x = "-30 mm", y = "-30 mm", orientation = "0 deg" }]
"""

from __future__ import annotations

import copy
import hashlib
import json
import tomllib
from collections import Counter
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from runtime import registry
from runtime.cell import HOLE_RADIUS_LIMIT, WIDEST_HOLE, Attendance, Board, Name, Safety, SearchLimits, Tolerances
from runtime.clock import parse_rate
from runtime.component import COMPONENTS, clearance_of_pins
from runtime.errors import CellError, InputError, alternatives
from runtime.network.meeting_point import DEFAULT_PORT, LOOPBACK, MeetingPoint
from runtime.network.sharing_point import check_endpoint, is_loopback
from runtime.plugin import Driver, Strategy
from runtime.settings import read

DEFAULT_CELL = "igbt"
Host = Annotated[str, Field(pattern=r"^[A-Za-z0-9:][A-Za-z0-9.:-]*$")]
SIMULATES = "arm"  # the one role that is told the tolerances and the seed


@dataclass(frozen=True)
class BusSettings:
    """Where the plugins meet: on loopback, or on a network with TLS and access control."""

    port: Annotated[int, Field(ge=1, le=65535)] = DEFAULT_PORT
    domain: Annotated[int, Field(ge=0, le=232)] = 0  # ROS_DOMAIN_ID
    listen: Host | Annotated[tuple[Host, ...], Field(min_length=1)] = LOOPBACK  # addresses of this machine
    security: Literal["none", "mtls"] = "none"
    keys: str = "keys"  # folder that `palpate keys` made, as seen from the cell file; for mtls

    @property
    def hosts(self) -> tuple[str, ...]:
        """What to listen on."""
        return (self.listen,) if isinstance(self.listen, str) else self.listen


@dataclass(frozen=True)
class PosteriorSettings:
    """What is remembered from earlier sessions."""

    path: str = ""  # of the store; empty: posterior.sqlite3 beside the logs
    share: str | tuple[str, ...] = ()  # routers where cells meet, "tcp/192.168.0.2:7460"; empty: alone
    keys: str = ""  # folder of keys for tls/, as seen from the cell file; empty: that of the bus, if it has mtls
    scope: str = "real"  # evidence of one physical or simulated world; set by the launcher for simulated ones

    @property
    def shared_through(self) -> tuple[str, ...]:
        """Endpoints of the routers where cells meet, in the order in which they are tried; none: alone."""
        return tuple(filter(None, (self.share,))) if isinstance(self.share, str) else self.share


@dataclass(frozen=True)
class Cell:
    """A whole cell."""

    board: Board
    robot: Name = "mujoco_ur3e"
    strategy: Name = "meta"
    component: str = "igbt"
    boards: Annotated[int, Field(ge=1, le=10_000)] = 1
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    rate: str = "max"
    search: SearchLimits = field(default_factory=SearchLimits)
    safety: Safety = field(default_factory=Safety)
    attendance: Attendance = field(default_factory=Attendance)
    tolerances: Tolerances = field(default_factory=Tolerances)
    bus: BusSettings = field(default_factory=BusSettings)
    posterior: PosteriorSettings = field(default_factory=PosteriorSettings)
    drivers: dict[str, dict[str, Any]] = field(default_factory=dict)
    strategies: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class CellFile:
    """A cell file as read: its text for the record, its document for the plugins, its values for us."""

    name: str
    text: str
    document: dict[str, Any]
    cell: Cell
    folder: Path = Path()  # where it lies

    @property
    def meeting_point(self) -> MeetingPoint:
        """Where the cell's plugins meet."""
        bus = self.cell.bus
        keys = self.folder / bus.keys if bus.security == "mtls" else None
        return MeetingPoint(bus.port, bus.domain, bus.hosts, keys)

    @property
    def sharing_keys(self) -> Path | None:
        """Folder of keys to share evidence with; None: without TLS."""
        return self.folder / self.cell.posterior.keys if self.cell.posterior.keys else self.meeting_point.keys


def shipped() -> dict[str, Path]:
    """Cell files that come with palpate, by bare name."""
    folder = Path(str(resources.files("runtime"))) / "cells"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find(name: str) -> Path:
    """Path of a cell file, given as a path or as a shipped name. Raises CellError naming what exists."""
    path = Path(name)
    if path.is_file():
        return path
    cells = shipped()
    if name in cells:
        return cells[name]
    if path.is_dir():
        raise CellError(f"{name} is a directory, not a cell file")
    raise CellError(f"no cell file {name!r}; cells that ship with palpate: {', '.join(cells)}")


def load(name: str, overrides: dict[str, Any] | None = None) -> CellFile:
    """Read and check a cell file, with top-level keys replaced by `overrides`. Raises CellError in one line."""
    path = find(name)
    try:
        text = path.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise CellError(f"{path.name}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise CellError(f"{path.name}: no valid TOML: {error}") from None
    for key, value in (overrides or {}).items():
        if isinstance(value, dict):
            document[key] = {**document.get(key, {}), **value}
        else:
            document[key] = value
    cell = cell_of(document, path.name)
    _check(cell, path.name)
    return CellFile(path.name, text, document, cell, path.parent)


def meeting_point(cell: str | None, port: int | None) -> MeetingPoint:
    """Where to join a cell that runs: as its file says, or without one on this machine. A port given goes before."""
    found = MeetingPoint() if cell is None else load(cell).meeting_point
    return found if port is None else replace(found, port=port)


def cell_of(document: dict[str, Any], where: str) -> Cell:
    """The values of a cell document. Raises CellError for a wrong key, type, unit or range."""
    return read(Cell, document, where)


def _check(cell: Cell, where: str) -> None:
    """Raise CellError or PluginError for what only shows when the values are seen together, or with the plugins."""
    if cell.component not in COMPONENTS:
        raise CellError(
            f"{where}: component: no part {cell.component!r} is known; {alternatives(cell.component, COMPONENTS)}"
        )
    try:
        parse_rate(cell.rate)
    except InputError as error:
        raise CellError(f"{where}: {error}") from None
    _check_bus(cell.bus, where)
    _check_sharing(cell, where)
    _check_holes(cell, where)
    for name in {*cell.strategies, cell.strategy}:
        registry.strategy(name, cell.strategies.get(name, {}), where)
    for name in {*cell.drivers, cell.robot}:
        registry.driver(name, cell.drivers.get(name, {}), where)


def robot_of(cell: Cell, where: str) -> Driver:
    """The cell's robot with its settings."""
    return registry.driver(cell.robot, cell.drivers.get(cell.robot, {}), where)


def strategy_of(cell: Cell, where: str) -> Strategy:
    """The cell's strategy with its settings."""
    return registry.strategy(cell.strategy, cell.strategies.get(cell.strategy, {}), where)


def _check_bus(bus: BusSettings, where: str) -> None:
    """Raise CellError for a cell that would be open to a network without protection."""
    outside = [host for host in bus.hosts if not is_loopback(host)]
    if outside and bus.security == "none":
        raise CellError(
            f"{where}: bus.listen: {outside[0]} is open to the network; make keys with 'palpate keys DIR --host "
            f'{outside[0]}\' beside the cell file and add security = "mtls" and keys = "DIR" to [bus]'
        )


def _check_sharing(cell: Cell, where: str) -> None:
    keys = bool(cell.posterior.keys) or cell.bus.security == "mtls"
    for endpoint in cell.posterior.shared_through:
        try:
            check_endpoint(endpoint, keys=keys)
        except InputError as error:
            raise CellError(f"{where}: posterior.share: {error}") from None


def _check_holes(cell: Cell, where: str) -> None:
    if not cell.board.holes:
        raise CellError(f"{where}: board.holes: a board needs at least one hole")
    twice = [name for name, count in Counter(hole.name for hole in cell.board.holes).items() if count > 1]
    if twice:
        raise CellError(f"{where}: board.holes: the name {twice[0]!r} stands twice; every hole has its own")
    for hole in cell.board.holes:
        if COMPONENTS[cell.component].polar and hole.orientation is None:
            raise CellError(
                f"{where}: board.holes: hole {hole.name!r} needs an orientation, such as "
                f'orientation = "0 deg": {cell.component} is a polar part'
            )
    for key in ("abnormal_hole", "jump_hole"):
        number = getattr(cell.tolerances, key)
        if not 0 <= number <= len(cell.board.holes):
            raise CellError(
                f"{where}: tolerances.{key}: {number} is no hole's number; "
                f"write 1 to {len(cell.board.holes)}, or 0 for none"
            )
    drawn, spread = cell.tolerances.hole_radius_error, HOLE_RADIUS_LIMIT * cell.tolerances.hole_radius
    if drawn + spread > WIDEST_HOLE or clearance_of_pins(COMPONENTS[cell.component]) + drawn - spread <= 0:
        raise CellError(
            f"{where}: tolerances.hole_radius: holes would be {1e3 * (drawn - spread):g} to "
            f"{1e3 * (drawn + spread):g} mm wider than drawn; {cell.component} needs "
            f"{-1e3 * clearance_of_pins(COMPONENTS[cell.component]):g} to {1e3 * WIDEST_HOLE:g} mm"
        )


def seed_for(seed: int, role: str) -> int:
    """A role's own seed, from which the session's cannot be found."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{role}".encode()).digest()[:7], "big")


def scope_of(document: dict[str, Any]) -> str:
    """Name of the simulated world that a document describes: evidence from one world is worth nothing in another."""
    world = {key: document.get(key) for key in ("seed", "tolerances", "robot")}
    return "simulated-" + hashlib.sha256(json.dumps(world, sort_keys=True).encode()).hexdigest()[:12]


def redacted(document: dict[str, Any], role: str) -> dict[str, Any]:
    """The document as one role may know it: without the truth, unless the role simulates it."""
    seen = copy.deepcopy(document)
    if role != SIMULATES:
        seen.pop("tolerances", None)
        seen["seed"] = seed_for(int(document.get("seed", Cell.seed)), role)
    return seen


def redacted_cell(cell: Cell, role: str) -> Cell:
    """Like `redacted`, for values."""
    if role == SIMULATES:
        return cell
    return replace(cell, tolerances=Tolerances(), seed=seed_for(cell.seed, role))
