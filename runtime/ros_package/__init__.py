"""palpate's own message types as a ROS 2 interface package, to be built with colcon.

The folder `palpate_msgs` beside this file is that package; it is written from the types' declarations, and a test keeps
both equal. `palpate messages --output DIR` writes it elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

from runtime.declaration import declared, definition
from runtime.errors import InputError
from runtime.messages import (
    AnswerGiven,
    Attempt,
    Choice,
    Ending,
    Intervention,
    InterventionAnswer,
    Need,
    Outcome,
    Permit,
    Phase,
    SafetyState,
    SearchResult,
    SessionState,
)
from runtime.messages.safety import Reset, ResetEdge

NAME = "palpate_msgs"
FOLDER = Path(__file__).parent / NAME
VERSION = "0.1.0"  # of the package
DEPENDENCIES = ("builtin_interfaces", "geometry_msgs", "std_msgs")
# Constants are no part of a type's hash, so that these definitions and those in a log name the same types.
ENUMERATIONS: dict[type[Any], tuple[str, type[IntEnum]]] = {
    AnswerGiven: ("choice", Choice),
    Attempt: ("outcome", Outcome),
    Intervention: ("need", Need),
    InterventionAnswer: ("choice", Choice),
    Permit: ("state", SafetyState),
    Reset: ("edge", ResetEdge),
    SearchResult: ("ending", Ending),
    SessionState: ("phase", Phase),
}

_PACKAGE = f"""\
<?xml version="1.0"?>
<package format="3">
  <name>{NAME}</name>
  <version>{VERSION}</version>
  <description>What a palpate cell says on its own topics: searches, candidates, attempts, permits.</description>
  <maintainer email="palpate@localhost.localdomain">palpate</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
{{depends}}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_CMAKE = f"""\
cmake_minimum_required(VERSION 3.16)
project({NAME})

find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{{packages}}

rosidl_generate_interfaces(${{{{PROJECT_NAME}}}}
{{files}}
  DEPENDENCIES {{dependencies}}
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""


def message_text(cls: type[Any]) -> str:
    """The `.msg` text of a type, with a constant for each value of its enumeration."""
    lines = definition(cls).splitlines()
    place = next(index for index, line in enumerate(lines) if not line.startswith("#"))
    parts = [lines[:place], lines[place:]]
    if cls in ENUMERATIONS:
        field, values = ENUMERATIONS[cls]
        parts.insert(1, [f"uint8 {value.name}={value.value}  # {field}" for value in values])
    return "\n\n".join("\n".join(part) for part in parts) + "\n"


def files() -> dict[str, str]:
    """Texts of the package by path within it."""
    messages = {f"msg/{cls.__name__}.msg": message_text(cls) for _, cls in sorted(declared().items())}
    cmake = _CMAKE.format(
        packages="\n".join(f"find_package({name} REQUIRED)" for name in DEPENDENCIES),
        files="\n".join(f'  "{path}"' for path in messages),
        dependencies=" ".join(DEPENDENCIES),
    )
    depends = "\n".join(f"  <depend>{name}</depend>" for name in DEPENDENCIES)
    return {"CMakeLists.txt": cmake, "package.xml": _PACKAGE.format(depends=depends), **messages}


def write(directory: Path, *, force: bool) -> Path:
    """Write the package into a directory; returns its folder.

    Raises InputError if that cannot be written, or if it is there already and shall not be replaced.
    """
    folder = directory / NAME
    if folder.exists() and not force:
        raise InputError(f"{folder} is there already; choose another directory, or add --force to replace its files")
    try:
        (folder / "msg").mkdir(parents=True, exist_ok=True)
        for stale in _stale(folder):
            stale.unlink()
        for path, text in files().items():
            (folder / path).write_text(text)
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror or error}") from None
    return folder


def _stale(folder: Path) -> Iterator[Path]:
    """Message files of types that are no more."""
    known = files()
    yield from (path for path in (folder / "msg").glob("*.msg") if f"msg/{path.name}" not in known)
