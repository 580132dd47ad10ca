"""Plugins found by entry points, loaded only when asked for.

A package offers its own by declaring, in its pyproject.toml:

    [project.entry-points."palpate.strategies"]
    mine = "my_package.mine:Mine"
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, is_dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from runtime.errors import PluginError, alternatives
from runtime.plugin import Driver, Strategy
from runtime.settings import read

STRATEGIES = "palpate.strategies"
DRIVERS = "palpate.drivers"
_METHODS = {STRATEGIES: "search", DRIVERS: "run"}
_KINDS = {STRATEGIES: "strategy", DRIVERS: "driver"}


@dataclass(frozen=True)
class Installed:
    """One installed plugin, or one that is declared but cannot be loaded."""

    name: str
    group: str
    package: str
    summary: str
    broken: str = ""


@cache
def _entries(group: str) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=group)}


def names(group: str) -> list[str]:
    """Names of the installed plugins of a group."""
    return sorted(_entries(group))


def load(group: str, name: str) -> type[Any]:
    """The class of a plugin. Raises PluginError naming what is installed instead."""
    kind = _KINDS[group]
    entry = _entries(group).get(name)
    if entry is None:
        raise PluginError(f"no {kind} {name!r} is installed; {alternatives(name, names(group))}")
    try:
        loaded = entry.load()
    except Exception as error:  # whatever a foreign package raises on import
        raise PluginError(f"{kind} {name!r} ({entry.value}) cannot be loaded: {error}") from error
    if not (isinstance(loaded, type) and is_dataclass(loaded) and callable(getattr(loaded, _METHODS[group], None))):
        raise PluginError(f"{kind} {name!r} ({entry.value}) is no dataclass with a method {_METHODS[group]!r}")
    return loaded


def strategy(name: str, settings: Mapping[str, Any], where: str) -> Strategy:
    """A strategy with its settings from a table."""
    made: Strategy = read(load(STRATEGIES, name), settings, f"{where}: strategies.{name}")
    return made


def driver(name: str, settings: Mapping[str, Any], where: str) -> Driver:
    """A driver with its settings from a table."""
    made: Driver = read(load(DRIVERS, name), settings, f"{where}: drivers.{name}")
    return made


def packages(plugins: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Versions of the packages that plugins (group, name) come from, by name of package."""
    entries = (_entries(group).get(name) for group, name in plugins)
    return {entry.dist.name: entry.dist.version for entry in entries if entry is not None and entry.dist is not None}


def installed() -> list[Installed]:
    """Every plugin with its summary, the first line of its docstring."""
    found = []
    for group in (DRIVERS, STRATEGIES):
        for name in names(group):
            entry = _entries(group)[name]
            package = entry.dist.name if entry.dist else ""
            try:
                doc = load(group, name).__doc__ or ""
                found.append(Installed(name, group, package, doc.strip().partition("\n")[0]))
            except PluginError as error:
                found.append(Installed(name, group, package, "", str(error)))
    return found
