"""Every public name of ur-rtde's interfaces, and the test that shows what it does to the simulation.

    python tests/ur_rtde_methods.py

prints the table. A test claims the methods that it tries with `covers`, and fails if it did not use one that it claims;
`left_out` says why a method is not tried. `test_ur_rtde_methods` compares the table with the installed ur-rtde.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import pytest

Test = TypeVar("Test", bound=Callable[..., None])

MODULES = {
    "RTDEReceiveInterface": "rtde_receive",
    "RTDEControlInterface": "rtde_control",
    "RTDEIOInterface": "rtde_io",
    "DashboardClient": "dashboard_client",
}


@dataclass(frozen=True)
class Row:
    """One public name of an interface."""

    interface: str
    method: str
    test: str  # "" if it is not tried
    text: str  # the effect that is checked, or why it is not tried


ROWS: list[Row] = []
_used: set[tuple[str, str]] = set()  # since the test under way began


def interface(name: str) -> Any:
    """A class of ur-rtde; the test module is skipped where ur-rtde is not installed."""
    return getattr(pytest.importorskip(MODULES[name]), name)


def public_names(name: str) -> set[str]:
    """What the installed interface offers."""
    return {item for item in dir(interface(name)) if not item.startswith("_")}


class Watched:
    """A client, or the class of one, that notes which of its names are used."""

    def __init__(self, name: str, client: Any) -> None:
        self._name = name
        self._client = client

    def __getattr__(self, method: str) -> Any:
        _used.add((self._name, method))
        return getattr(self._client, method)


def covers(name: str, **effects: str) -> Callable[[Test], Test]:
    """Claim that a test tries methods of an interface, and checks their effects."""

    def mark(test: Test) -> Test:
        ROWS.extend(Row(name, method, f"{test.__module__}::{test.__name__}", text) for method, text in effects.items())

        @functools.wraps(test)
        def run(*args: Any, **kwargs: Any) -> None:
            _used.clear()
            test(*args, **kwargs)
            unused = sorted(method for method in effects if (name, method) not in _used)
            assert not unused, f"{test.__name__} claims to try {', '.join(unused)} of {name} and does not"

        return run  # type: ignore[return-value]

    return mark


def left_out(name: str, **reasons: str) -> None:
    """Say why methods of an interface are not tried."""
    ROWS.extend(Row(name, method, "", reason) for method, reason in reasons.items())


def collect() -> list[Row]:
    """The rows of all test modules, by interface and name."""
    for path in sorted(Path(__file__).parent.glob("test_ur_rtde_*.py")):
        importlib.import_module(path.stem)
    order = list(MODULES)
    return sorted(ROWS, key=lambda row: (order.index(row.interface), row.method))


def show(rows: list[Row], width: int | None = None) -> None:
    """Print the table."""
    from rich.console import Console
    from rich.table import Table

    table = Table("interface", "method", "tried", "effect checked in the simulation, or why not tried")
    for row in rows:
        table.add_row(row.interface, row.method, "yes" if row.test else "no", row.text)
    names = {(row.interface, row.method) for row in rows}
    tried = {(row.interface, row.method) for row in rows if row.test}
    console = Console(width=width)
    console.print(table)
    console.print(f"{len(names)} public names of ur-rtde, {len(tried)} tried, {len(names - tried)} not")


if __name__ == "__main__":
    # Test modules fill the table of the module that they import, which is not this one.
    from ur_rtde_methods import collect as _collect
    from ur_rtde_methods import show as _show

    _show(_collect())
