"""How ROS 2 names things on Zenoh, so that a ROS 2 node sees a cell with no bridge between.

Source: docs/design.md, rmw_publisher_data.cpp, attachment_helpers.cpp and liveliness_utils.cpp of ros2/rmw_zenoh
(jazzy). Pure functions; nothing here touches a network.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import xxhash

from runtime.declaration import type_name
from runtime.errors import BusError
from runtime.messages import typestore
from runtime.topics import Topic

DOMAIN = 0  # ROS_DOMAIN_ID
QOS_DEFAULT = "::,10:,:,:,,"  # reliable, volatile, keep last 10
QOS_LATCHED = ":1:,1:,:,:,,"  # reliable, transient local, keep last 1
_ATTACHMENT = struct.Struct("<qqB16s")  # sequence, source time [ns], length of the identity, identity


def mangled(ros_type: str) -> str:
    """`package/msg/Type` as DDS spells it."""
    package, kind, name = ros_type.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def unmangled(dds_type: str) -> str:
    """Inverse of `mangled`. Raises BusError for what is no DDS spelling."""
    parts = dds_type.split("::")
    if len(parts) != 4 or parts[2] != "dds_" or not parts[3].endswith("_"):
        raise BusError(f"{dds_type!r} is no DDS type name")
    return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"


@cache
def type_hash(ros_type: str) -> str:
    """RIHS01 hash of a ROS type."""
    return typestore().hash_rihs01(ros_type)


def key(topic: Topic[Any], domain: int = DOMAIN) -> str:
    """Key expression that a topic's messages travel under."""
    ros_type = type_name(topic.type)
    return f"{domain}/{topic.name.strip('/')}/{mangled(ros_type)}/{type_hash(ros_type)}"


@lru_cache(maxsize=1000)  # a cell has some dozen keys
def parse_key(text: str) -> tuple[str, str]:
    """Topic name and ROS type of a key expression. Raises BusError if it is none of rmw_zenoh's."""
    parts = text.split("/")
    if len(parts) < 4 or not parts[0].isdigit():
        raise BusError(f"{text!r} is no key of rmw_zenoh")
    return "/" + "/".join(parts[1:-2]), unmangled(parts[-2])


def node_token(session_id: str, node: str, domain: int = DOMAIN) -> str:
    """Liveliness token of a node."""
    return f"@ros2_lv/{domain}/{session_id}/0/0/NN/%/%/{node}"


def node_tokens(domain: int = DOMAIN) -> str:
    """Key expression that matches every node's token."""
    return f"@ros2_lv/{domain}/*/*/*/NN/%/%/*"


def entity_token(kind: str, session_id: str, entity: int, node: str, topic: Topic[Any], domain: int = DOMAIN) -> str:
    """Liveliness token of a publisher (`MP`) or subscriber (`MS`)."""
    ros_type = type_name(topic.type)
    qos = QOS_LATCHED if topic.latched else QOS_DEFAULT
    name = topic.name.replace("/", "%")
    who = f"{session_id}/0/{entity}/{kind}/%/%/{node}"
    return f"@ros2_lv/{domain}/{who}/{name}/{mangled(ros_type)}/{type_hash(ros_type)}/{qos}"


def identity(token: str) -> bytes:
    """GID of a publisher: (16,) XXH3-128 of its token, low half first."""
    digest = xxhash.xxh3_128(token.encode()).intdigest()
    return (digest & (1 << 64) - 1).to_bytes(8, "little") + (digest >> 64).to_bytes(8, "little")


@dataclass(frozen=True, slots=True)
class Attachment:
    """What travels beside every message."""

    sequence: int  # from 1
    stamp: int  # source time [ns]; palpate puts session time here
    publisher: bytes  # (16,)

    def pack(self) -> bytes:
        """(33,) bytes."""
        return _ATTACHMENT.pack(self.sequence, self.stamp, len(self.publisher), self.publisher)

    @classmethod
    def unpack(cls, data: bytes) -> Attachment:
        """Inverse of `pack`. Raises BusError for bytes that are no attachment."""
        return cls(*unpacked(data))


def unpacked(data: bytes) -> tuple[int, int, bytes]:
    """Sequence, stamp [ns] and publisher (16,) of an attachment. Raises BusError for bytes that are none."""
    if len(data) != _ATTACHMENT.size:
        raise BusError(f"an attachment has {_ATTACHMENT.size} bytes, not {len(data)}")
    sequence, stamp, length, publisher = _ATTACHMENT.unpack(data)
    if length != 16:
        raise BusError(f"a publisher's identity has 16 bytes, not {length}")
    if sequence < 1 or stamp < 0:
        raise BusError(f"sequence {sequence} or stamp {stamp} ns is none")
    return sequence, stamp, publisher
