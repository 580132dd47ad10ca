"""Messages, quantities and the names they have on the wire."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.stores import ros2_jazzy

from runtime import messages
from runtime.bus import decode, encode
from runtime.declaration import Ros, declared, definition, type_name
from runtime.errors import BusError
from runtime.messages import nanoseconds_of, stamp_of
from runtime.network import rmw_zenoh
from runtime.quantity import UNITS, parse
from runtime.topics import Topic, topics

NUMBERS: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    "uint8": st.integers(0, 2**8 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "float64": st.floats(allow_nan=False),
    "string": st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20),
}


def values_of(hint: Any) -> st.SearchStrategy[Any]:
    """Values of a message type, made from its declaration."""
    if get_origin(hint) is list:
        return st.lists(values_of(get_args(hint)[0]), max_size=3)
    ros = next((item for item in get_args(hint) if isinstance(item, Ros)), None)
    if ros is not None and ros.type == "float64[]":
        return st.lists(NUMBERS["float64"], max_size=5).map(np.array)
    if ros is not None:
        return NUMBERS[ros.type]
    if hint.__msgtype__ == "builtin_interfaces/msg/Time":
        return st.integers(0, 2**31 * 10**9 - 1).map(stamp_of)
    if hint in declared().values():
        hints = get_type_hints(hint, include_extras=True)
        return st.builds(hint, **{field.name: values_of(hints[field.name]) for field in fields(hint)})
    assert is_dataclass(hint)
    plain = {"float": NUMBERS["float64"], "int": st.integers(0, 100), "str": NUMBERS["string"]}
    hints = {field.name: field.type for field in fields(hint) if field.name != "__msgtype__"}
    return st.builds(
        hint,
        **{
            name: plain[str(kind)] if str(kind) in plain else values_of(getattr(ros2_jazzy, str(kind)))
            for name, kind in hints.items()
        },
    )


@pytest.mark.parametrize("cls", declared().values(), ids=lambda cls: cls.__name__)
@given(data=st.data())
def test_every_message_survives_the_wire(cls: type[Any], data: st.DataObject) -> None:
    message = data.draw(values_of(cls))
    arrived = decode(encode(message), cls)
    for field in fields(cls):
        np.testing.assert_array_equal(getattr(arrived, field.name), getattr(message, field.name))


@pytest.mark.parametrize("cls", declared().values(), ids=lambda cls: cls.__name__)
def test_the_msg_text_alone_is_enough_for_another_ros_tool(cls: type[Any]) -> None:
    foreign = get_typestore(Stores.ROS2_JAZZY)
    for name, each in declared().items():
        foreign.register(get_types_from_msg(definition(each), name))
    name = type_name(cls)
    assert foreign.hash_rihs01(name) == rmw_zenoh.type_hash(name)
    assert [field.name for field in fields(cls)] == [item[0] for item in foreign.fielddefs[name][1]]


def test_the_map_names_a_type_a_publisher_and_a_meaning_for_every_topic() -> None:
    for name, topic in topics().items():
        assert name.startswith("/")
        assert topic.publisher
        assert topic.meaning
        assert topic.rate
        assert type_name(topic.type) in messages.typestore().fielddefs


@pytest.mark.parametrize("topic", topics().values(), ids=lambda topic: topic.name)
def test_a_key_names_topic_and_type(topic: Topic[Any]) -> None:
    key = rmw_zenoh.key(topic)
    assert rmw_zenoh.parse_key(key) == (topic.name, type_name(topic.type))


def test_keys_and_tokens_are_spelt_as_rmw_zenoh_does() -> None:
    topic = topics()["/joint_states"]
    joint_state = (
        "sensor_msgs::msg::dds_::JointState_/RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert rmw_zenoh.key(topic) == f"0/joint_states/{joint_state}"
    assert (
        rmw_zenoh.entity_token("MP", "aac3178e146ba6f1fc6e6a4085e77f21", 5, "arm", topic)
        == f"@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/5/MP/%/%/arm/%joint_states/{joint_state}/::,10:,:,:,,"
    )


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_survives(sequence: int, stamp: int, publisher: bytes) -> None:
    attachment = rmw_zenoh.Attachment(sequence, stamp, publisher)
    packed = attachment.pack()
    assert len(packed) == 33
    assert rmw_zenoh.Attachment.unpack(packed) == attachment


@given(st.binary(max_size=60).filter(lambda data: len(data) != 33))
def test_other_bytes_are_no_attachment(data: bytes) -> None:
    with pytest.raises(BusError, match="33 bytes"):
        rmw_zenoh.Attachment.unpack(data)


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_times_survive(nanoseconds: int) -> None:
    assert nanoseconds_of(stamp_of(nanoseconds)) == nanoseconds


@given(
    st.sampled_from([(dimension, unit) for dimension, units in UNITS.items() for unit in units]),
    st.floats(-1e6, 1e6),
    st.sampled_from(["", " ", "  "]),
)
def test_a_quantity_is_its_number_times_its_unit(kind: tuple[str, str], number: float, gap: str) -> None:
    dimension, unit = kind
    assert math.isclose(parse(f"{number!r}{gap}{unit}", dimension), number * UNITS[dimension][unit], abs_tol=1e-300)


@pytest.mark.parametrize("text", ["3", "mm", "3 parsec", "3 N", "", "three mm", "nan mm", "inf mm", "1e999 x"])
def test_what_is_no_length_is_refused_with_the_units_that_would_do(text: str) -> None:
    with pytest.raises(ValueError, match="mm"):
        parse(text, "length")
