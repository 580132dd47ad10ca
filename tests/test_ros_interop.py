"""A ROS 2 node on rmw_zenoh sees and echoes a running cell: its part is played by plain Zenoh, set up as rmw_zenoh is.

The listener knows nothing of palpate: what there is to hear it takes from liveliness tokens, what it means from
rosbags' copy of the ROS types and the mcap project's decoder. The conventions are those of ros2/rmw_zenoh, jazzy 0.2.4:
docs/design.md, liveliness_utils.cpp, rmw_publisher_data.cpp, rmw_subscription_data.cpp, attachment_helpers.cpp.
"""

from __future__ import annotations

import json
import queue
import re
import struct
import time
from collections import defaultdict
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any

import pytest
import xxhash
import zenoh
from cells import Palpate, cell_text, write_cell
from command_line import CommandLine
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh import ext

from runtime.declaration import declared
from runtime.messages import SafetyState, arm, attendance, safety, search, session
from runtime.network.rmw_zenoh import type_hash
from runtime.ros_package import DEPENDENCIES, ENUMERATIONS, FOLDER, files

PATIENCE = 60.0  # [s]
RELIABLE, TRANSIENT_LOCAL, VOLATILE = 1, 1, 2  # rmw_qos_reliability_policy_e, rmw_qos_durability_policy_e
STANDARD = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/force_torque_sensor_broadcaster/wrench": "geometry_msgs/msg/WrenchStamped",
    "/tcp_pose_broadcaster/pose": "geometry_msgs/msg/PoseStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/robot_description": "std_msgs/msg/String",
    "/clock": "rosgraph_msgs/msg/Clock",
    "/rosout": "rcl_interfaces/msg/Log",
}
LATCHED = {"/tf_static", "/robot_description"}
MODULES = (arm, attendance, safety, search, session)
ROS = get_typestore(Stores.ROS2_JAZZY)


@dataclass(frozen=True)
class Entity:
    """What a liveliness token says."""

    token: str
    domain: str
    session: str
    node_id: str
    id: str
    kind: str
    enclave: str
    namespace: str
    node: str
    topic: str = ""
    type: str = ""
    hash: str = ""
    qos: str = ""

    @classmethod
    def parse(cls, token: str) -> Entity:
        space, *parts = token.split("/")
        assert space == "@ros2_lv"
        assert all(parts), token
        assert len(parts) == (8 if parts[4] == "NN" else 12), token
        return cls(token, *(part.replace("%", "/") for part in parts))

    @property
    def key(self) -> str:
        return f"{self.domain}/{self.topic.strip('/')}/{self.type}/{self.hash}"

    @property
    def ros_type(self) -> str:
        package, kind, name = re.fullmatch(r"(\w+)::(\w+)::dds_::(\w+)_", self.type).groups()  # type: ignore[union-attr]
        return f"{package}/{kind}/{name}"

    @property
    def gid(self) -> bytes:
        digest = xxhash.xxh3_128_intdigest(self.token.encode())
        return struct.pack("<QQ", digest & (1 << 64) - 1, digest >> 64)

    def policies(self) -> tuple[int, int, int]:
        """Reliability, durability and depth; what is left out is rmw_zenoh's default."""
        reliability, durability, history, deadline, lifespan, liveliness = self.qos.split(":")
        _, depth = history.split(",")
        assert [len(part.split(",")) for part in (deadline, lifespan, liveliness)] == [2, 2, 3]
        return int(reliability or RELIABLE), int(durability or VOLATILE), int(depth or 42)


@dataclass
class Node:
    """A ROS 2 node that echoes whatever it is told to."""

    session: zenoh.Session
    entities: dict[str, Entity] = field(default_factory=dict)  # by token
    heard: queue.SimpleQueue[tuple[str, Any]] = field(default_factory=queue.SimpleQueue)  # token of a topic, sample
    subscribers: dict[str, Any] = field(default_factory=dict)  # by key

    @classmethod
    def start(cls, port: int) -> Node:
        config = zenoh.Config()
        for name, value in {
            "mode": "peer",
            "connect/endpoints": [f"tcp/localhost:{port}"],
            "listen/endpoints": ["tcp/localhost:0"],
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": True,
            "timestamping/enabled": {"router": True, "peer": True, "client": False},
        }.items():
            config.insert_json5(name, json.dumps(value))
        node = cls(zenoh.open(config))
        node.graph = node.session.liveliness().declare_subscriber("@ros2_lv/0/**", node._on_token, history=True)
        return node

    def _on_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            entity = Entity.parse(str(sample.key_expr))
            self.entities[entity.token] = entity

    def publishers(self) -> list[Entity]:
        return [entity for entity in list(self.entities.values()) if entity.kind == "MP"]

    def echo(self, publisher: Entity) -> None:
        """Subscribe as rmw_zenoh does to a publisher with these policies."""
        if publisher.key in self.subscribers:
            return
        reliability, durability, depth = publisher.policies()
        options: dict[str, Any] = {}
        if durability == TRANSIENT_LOCAL:
            options["subscriber_detection"] = True
            options["history"] = ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)
            if reliability == RELIABLE:
                options["recovery"] = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        self.subscribers[publisher.key] = ext.declare_advanced_subscriber(
            self.session, publisher.key, lambda sample: self.heard.put((publisher.topic, sample)), **options
        )


def decoder(ros_type: str) -> Any:
    text, _ = ROS.generate_msgdef(ros_type, ros_version=2)
    schema = Schema(id=1, data=text.encode(), encoding="ros2msg", name=ros_type)
    found = DecoderFactory().decoder_for("cdr", schema)
    assert found is not None
    return found


def test_a_ros_2_node_sees_and_echoes_every_standard_topic_of_a_running_cell(tmp_path: Path) -> None:
    palpate = Palpate(tmp_path)
    text = cell_text(holes=1, max_attempts="1", hole_bias='"3 mm"', strategy='"linear"', rate='"4.0"')
    process = palpate.start("launch", write_cell(tmp_path, text), "--port", str(palpate.port))
    node = Node.start(palpate.port)
    samples: dict[str, list[Any]] = defaultdict(list)
    late = False
    try:
        deadline = time.monotonic() + PATIENCE
        while process.poll() is None and time.monotonic() < deadline:
            for publisher in node.publishers():
                latched = publisher.policies()[1] == TRANSIENT_LOCAL
                if late or not latched:
                    node.echo(publisher)
            try:
                topic, sample = node.heard.get(timeout=0.1)
            except queue.Empty:
                continue
            samples[topic].append(sample)
            # What is latched was sent before the arm first moved.
            late = late or len(samples["/joint_states"]) > 25
        assert late
        _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, err
    finally:
        node.session.close()
        process.kill()
    while not node.heard.empty():
        topic, sample = node.heard.get()
        samples[topic].append(sample)
    check_graph(node)
    check_samples(node, samples)


def check_graph(node: Node) -> None:
    """Tokens as `ros2 node list` and `ros2 topic list -t` want them."""
    nodes = {(item.session, item.node_id, item.node) for item in node.entities.values() if item.kind == "NN"}
    ids = [(item.session, item.id) for item in node.entities.values()]
    assert len(set(ids)) == len(ids)
    assert {name for _, _, name in nodes} >= {"arm", "light_curtain", "interlock", "strategy", "assembly", "recorder"}
    for item in node.entities.values():
        assert (item.domain, item.enclave, item.namespace) == ("0", "/", "/")
        assert (item.session, item.node_id, item.node) in nodes
    publishers = node.publishers()
    types = {item.topic: item.ros_type for item in publishers if not item.ros_type.startswith("palpate_msgs/")}
    assert types.items() >= STANDARD.items()
    assert {item.topic for item in publishers if item.policies()[1] == TRANSIENT_LOCAL} >= LATCHED
    for item in publishers:
        if item.topic in types:
            assert item.hash == ROS.hash_rihs01(item.ros_type), item.topic


def check_samples(node: Node, samples: dict[str, list[Any]]) -> None:
    """Every standard topic was heard, whole and in order, from the publishers that the tokens name."""
    standard = {item.topic: item for item in node.publishers() if not item.ros_type.startswith("palpate_msgs/")}
    assert standard.keys() <= samples.keys()
    messages: dict[str, list[Any]] = defaultdict(list)
    for topic, entity in standard.items():
        decode = decoder(entity.ros_type)
        senders = {item.gid for item in node.publishers() if item.topic == topic}
        last: dict[bytes, int] = {}
        for sample in samples[topic]:
            sequence, stamp, length, gid = struct.unpack("<qqB16s", bytes(sample.attachment))
            assert length == 16
            assert gid in senders
            assert stamp >= 0
            assert sequence == last.get(gid, sequence - 1) + 1
            last[gid] = sequence
            messages[topic].append(decode(bytes(sample.payload)))
    assert len(messages["/joint_states"][-1].position) == 6
    assert messages["/joint_states"][-1].name[0] == "shoulder_pan_joint"
    assert {len(messages[topic]) for topic in LATCHED} == {1}
    assert messages["/robot_description"][0].data.startswith("<robot name=")
    assert "the budget of 1 attempts is spent" in " ".join(line.msg for line in messages["/rosout"])
    seconds = [message.clock.sec for message in messages["/clock"]]
    assert seconds == sorted(seconds)


def texts(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_the_ros_2_package_defines_the_types_that_the_cell_speaks() -> None:
    shipped = texts(FOLDER)
    assert shipped == files(), "run `palpate messages --output runtime/ros_package --force`"
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for path in sorted(FOLDER.glob("msg/*.msg")):
        types |= get_types_from_msg(path.read_text(), f"palpate_msgs/msg/{path.stem}")
    store.register(types)
    assert types.keys() == declared().keys()
    assert {name: store.hash_rihs01(name) for name in types} == {name: type_hash(name) for name in types}
    used = set(re.findall(r"^(\w+)/\w+", "".join(text for path, text in shipped.items() if "msg/" in path), re.M))
    assert used == {*DEPENDENCIES, "palpate_msgs"}
    assert {values for _, values in ENUMERATIONS.values()} == set(IntEnum.__subclasses__()) & {
        value for module in MODULES for value in vars(module).values() if isinstance(value, type)
    }
    for cls, (item, values) in ENUMERATIONS.items():
        text = shipped[f"msg/{cls.__name__}.msg"]
        assert dict(re.findall(rf"^uint8 (\w+)=(\d+)  # {item}$", text, re.M)) == {
            value.name: str(value.value) for value in values
        }
    # rosidl's rule for names of fields
    names = [name for fields in types.values() for name, _ in fields[1]]
    assert all(re.fullmatch(r"(?!.*__)(?!.*_$)[a-z][a-z0-9_]*", name) for name in names)


def test_the_package_is_copied_into_a_workspace(tmp_path: Path) -> None:
    palpate = CommandLine(tmp_path)
    listed = palpate.run("messages")
    assert re.search(r"^palpate_msgs/msg/Permit +/safety/permit +The interlock's word", listed.stdout, re.M)
    assert str(FOLDER) in listed.stdout
    done = palpate.run("messages", "--output", "ws/src")
    assert done.returncode == 0, done.stderr
    written = tmp_path / "ws" / "src" / "palpate_msgs"
    assert texts(written) == files()
    assert f"uint8 TRIPPED={int(SafetyState.TRIPPED)}" in (written / "msg" / "Permit.msg").read_text()
    (written / "msg" / "Stale.msg").touch()
    again = palpate.run("messages", "--output", "ws/src")
    assert (again.returncode, again.stderr.count("\n")) == (2, 1)
    assert "add --force" in again.stderr
    assert palpate.run("messages", "--output", "ws/src", "--force").returncode == 0
    assert not (written / "msg" / "Stale.msg").exists()


@pytest.mark.parametrize("place", ["file", "file/inside"])
def test_a_place_that_cannot_be_written_is_named(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").touch()
    done = CommandLine(tmp_path).run("messages", "--output", place)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "cannot be written" in done.stderr
