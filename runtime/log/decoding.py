"""How the messages of a log become today's, those too that were written when their type was defined differently.

A log holds each type's own definition. Where that is not today's, messages are read by it and then carried over field
by field: what the log lacks takes the class's default, what today's class lacks is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields
from types import MappingProxyType
from typing import Any

from mcap.well_known import MessageEncoding
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from runtime.errors import LogError
from runtime.messages import typestore
from runtime.network.rmw_zenoh import type_hash

Recorded = Mapping[type[Any], frozenset[str]]
"""Fields that a log has of each class that it defines differently; of any other class it has all."""

_Carry = Callable[[Any], Any]


@dataclass(frozen=True)
class Decoding:
    """How to read one type of one log."""

    type: str  # ROS type name
    store: Typestore
    carry: _Carry | None = None  # from the log's class to today's; None: they are the same
    recorded: Recorded = field(default_factory=lambda: MappingProxyType({}))

    def decode(self, payload: bytes) -> Any:
        """The message. Raises what rosbags raises, of several types, on malformed bytes."""
        message = self.store.deserialize_cdr(payload, self.type)
        return message if self.carry is None else self.carry(message)


def decoding_of(ros_type: str, encoding: str, definition: str, recorded_hash: str) -> Decoding:
    """How to read a type as a log defines it. Raises LogError, without the log's name, where palpate cannot."""
    reason = unreadable(ros_type, encoding, definition)
    if reason:
        raise LogError(reason)
    if not recorded_hash or recorded_hash == type_hash(ros_type):
        return Decoding(ros_type, typestore())
    store = _own_store(ros_type, definition)
    if ros_type not in typestore().types:
        return Decoding(ros_type, store)
    recorded: dict[type[Any], frozenset[str]] = {}
    carry = _Carrier(store, recorded).message(ros_type)
    return Decoding(ros_type, store, carry, recorded)


def unreadable(ros_type: str, encoding: str, definition: str) -> str:
    """Why messages of a type cannot be read at all; empty if they can."""
    if encoding != MessageEncoding.CDR:
        return f"{ros_type or 'the type'} is encoded as {encoding!r}; palpate reads ROS 2 messages (cdr)"
    if ros_type not in typestore().types and not _learn(ros_type, definition):
        return f"palpate does not know the type {ros_type}, and the log has no definition of it"
    return ""


def unpublishable(ros_type: str, encoding: str, definition: str, recorded_hash: str) -> str:
    """Why messages of a type cannot be published as they were recorded; empty if they can."""
    reason = unreadable(ros_type, encoding, definition)
    if not reason and recorded_hash and recorded_hash != type_hash(ros_type):
        reason = _otherwise(ros_type)
    return reason


def _otherwise(ros_type: str) -> str:
    return f"{ros_type} was recorded by a version of palpate that defined it differently"


def _learn(ros_type: str, definition: str) -> bool:
    """Add a type that only the log defines; whether it is known now."""
    if not definition.strip():
        return False
    try:
        typestore().register(get_types_from_msg(definition, ros_type))
    except Exception:  # rosbags raises several types for text that is no definition or contradicts a known one
        return False
    return ros_type in typestore().types


def _own_store(ros_type: str, definition: str) -> Typestore:
    """The log's own types; what its text names and does not define is taken from today's."""
    if not definition.strip():
        raise LogError(f"{_otherwise(ros_type)}, and the log has no definition of it")
    store = get_typestore(Stores.EMPTY)
    try:
        types = dict(get_types_from_msg(definition, ros_type))
        waiting = list(types)
        while waiting:
            for _, kind in types[waiting.pop()][1]:
                name = _type_within(kind)
                if name and name not in types:
                    types[name] = typestore().fielddefs[name]
                    waiting.append(name)
        store.register(types)
    except Exception as error:  # rosbags raises several types for text that is no definition
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise LogError(f"{_otherwise(ros_type)}, and its definition in the log cannot be read: {reason}") from None
    return store


def _type_within(kind: Any) -> str:
    """The message type of a field or of its items; empty for a plain value."""
    node, value = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _type_within(value[0])
    return str(value) if node == Nodetype.NAME else ""


@dataclass
class _Carrier:
    """Makes the functions that carry messages of a log's store over to today's classes."""

    store: Typestore
    recorded: dict[type[Any], frozenset[str]]

    def message(self, ros_type: str) -> _Carry:
        """A function for messages of one type."""
        today = typestore().types.get(ros_type)
        if today is None:
            return _as_it_is
        old, steps = dict(self.store.fielddefs[ros_type][1]), []
        known = {item.name: item for item in fields(today)}  # type: ignore[arg-type]
        for name, kind in typestore().fielddefs[ros_type][1]:
            if name in old:
                steps.append((name, self._field(f"{ros_type}.{name}", old[name], kind)))
            elif not _has_default(known[name]):
                raise LogError(f"{_otherwise(ros_type)}: without {name}, which nothing can stand in for")
        self.recorded[today] = frozenset(name for name, _ in steps)

        def carry(message: Any) -> Any:
            return today(**{name: convert(getattr(message, name)) for name, convert in steps})

        return carry

    def _field(self, place: str, old: Any, new: Any) -> _Carry:
        ros_type = place.rpartition(".")[0]
        within = _type_within(new)
        if within and _type_within(old) == within and old[0] == new[0]:
            one = self.message(within)
            return one if new[0] == Nodetype.NAME else lambda items: [one(item) for item in items]
        if _values(old) != _values(new):
            raise LogError(f"{_otherwise(ros_type)}: {place.rpartition('.')[2]} was of another kind")
        return _as_it_is


def _as_it_is(value: Any) -> Any:
    return value


def _has_default(item: Field[Any]) -> bool:
    return item.default is not MISSING or item.default_factory is not MISSING


def _values(kind: Any) -> tuple[str, ...]:
    """What a field's values are in Python: widths of numbers do not matter, except within arrays."""
    node, value = kind
    if node == Nodetype.NAME:
        return ("message", str(value))
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return ("list", *map(str, value[0]))
    name = value[0]
    if "int" in name or name in {"byte", "char"}:
        return ("integer",)
    return ("number",) if name.startswith("float") else (name,)
