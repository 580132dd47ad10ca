"""Which code a result comes from: a digest of the source files that its modules import, directly or not.

Only files of the project that a module belongs to are followed. What a result also depends on are the versions of the
numerical packages; they are part of the digest.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

OWN = frozenset({"runtime", "drivers", "strategies"})
ASIDE = frozenset(  # what they carry or show decides nothing, and what they name is part of the content
    {
        "runtime.experiment.contenders",
        "runtime.experiment.worlds",
        "runtime.experiment.study",
        "runtime.bus",
        "runtime.context",
        "runtime.topics",
        "runtime.network.zenoh_bus",
        "runtime.local_bus",
        "runtime.evidence.store",
        "drivers.ur3e.control_box",
        "drivers.ur3e.job",
        "drivers.ur3e.picture",
        "drivers.ur3e.portrait",
    }
)
PACKAGES = ("numpy", "scipy", "mujoco", "pin")


@cache
def digest(modules: tuple[str, ...]) -> str:
    """Digest of the source of `modules`, of all they import from their own project, and of the packages' versions."""
    found = hashlib.sha256()
    for name, path in sorted(_closure(modules).items()):
        found.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    for package in PACKAGES:
        found.update(f"{package} {_version(package)}\0".encode())
    return found.hexdigest()


def files(modules: tuple[str, ...]) -> dict[str, Path]:
    """The source files that `digest` reads, by module."""
    return dict(sorted(_closure(modules).items()))


def _closure(modules: tuple[str, ...]) -> dict[str, Path]:
    own = OWN | {_top(module) for module in modules}
    found: dict[str, Path] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        path = _path(name)
        if name in found or path is None or _is_aside(name):
            continue
        found[name] = path
        waiting.append(name.rpartition(".")[0])  # a package's own code runs before its modules'
        waiting += [used for used in _imports(name, path) if _top(used) in own]
    return found


def _top(name: str) -> str:
    """The package that a module belongs to."""
    return name.partition(".")[0]


def _is_aside(name: str) -> bool:
    return any(name == aside or name.startswith(aside + ".") for aside in ASIDE)


@cache
def _path(name: str) -> Path | None:
    try:
        spec = find_spec(name)
    except (ImportError, ValueError):
        return None
    origin = spec.origin if spec else None
    return Path(origin) if origin and origin.endswith(".py") else None


@cache
def _imports(name: str, path: Path) -> tuple[str, ...]:
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]
    return tuple(_imported(ast.parse(path.read_bytes()), package))


def _imported(node: ast.AST, package: str) -> Iterator[str]:
    """Modules that are imported anywhere within, but not for type checkers alone."""
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
        source = ".".join([*above, *([node.module] if node.module else [])])
        yield source
        yield from (f"{source}.{alias.name}" for alias in node.names)  # each may be a module itself
    for child in ast.iter_child_nodes(node):
        yield from _imported(child, package)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
