"""Tables of a cell file as frozen dataclasses: key, type, unit and range are checked, and an error names its place."""

from __future__ import annotations

import json
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter, ValidationError

from runtime.errors import CellError, alternatives

Settings = TypeVar("Settings")


def read(cls: type[Settings], table: Mapping[str, Any], where: str) -> Settings:
    """Build the dataclass `cls` from a table. Raises CellError; `where` is the file, and the table within it if any."""
    _refuse_unknown_keys(cls, table, where, "")
    try:
        return TypeAdapter(cls).validate_json(json.dumps(table), strict=True)
    except TypeError as error:  # a TOML date or time
        raise CellError(f"{where}: {error}; use text, numbers, booleans, lists and tables") from None
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        place = ".".join(str(part) for part in first["loc"] if not _is_type_tag(part))
        got = "" if first["type"] == "quantity" or "input" not in first else f" (got {_shown(first['input'])})"
        if first["type"] == "missing":
            got = ""
        more = f" (and {len(others)} more)" if others else ""
        raise CellError(f"{where}: {place}: {_lower(first['msg'])}{got}{more}") from None


def _is_type_tag(part: object) -> bool:
    return isinstance(part, str) and ("[" in part or part[:1].isupper())


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _lower(text: str) -> str:
    return text[:1].lower() + text[1:]


def _refuse_unknown_keys(hint: Any, value: Any, where: str, place: str) -> None:
    """Walk dataclasses, and lists of them, in parallel with the table."""
    for option in get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,):
        if is_dataclass(option) and isinstance(option, type) and isinstance(value, Mapping):
            known = [field.name for field in fields(option)]
            hints = get_type_hints(option)
            for key, item in value.items():
                if key not in known:
                    raise CellError(f"{where}: {place}{key}: unknown key; {alternatives(key, known)}")
                _refuse_unknown_keys(hints[key], item, where, f"{place}{key}.")
        elif get_origin(option) in (tuple, list) and isinstance(value, list):
            for index, item in enumerate(value):
                _refuse_unknown_keys(get_args(option)[0], item, where, f"{place}{index}.")
