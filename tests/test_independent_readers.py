"""A log is read by programs that are not ours: Rerun, rosbags, and the mcap project's ROS 2 decoder, on every topic."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cells import cell_text, write_cell
from log_samples import rerun
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rerun.chunk import RrdReader
from rosbags.highlevel import AnyReader

from runtime import config
from runtime.in_process import run_in_process
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.topics import topics


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a small session, with a stop in it."""
    folder = tmp_path_factory.mktemp("session")
    script = 'interruptions = [{ at = "3 s", clear_after = "0.5 s", reset_after = "0.1 s" }]\n'
    text = cell_text(holes=1, strategy='"bayes-slide"').replace("[safety]\n", "[safety]\n" + script)
    return run_in_process(Order(config.load(str(write_cell(folder, text)), {}), folder / "logs")).log


@pytest.fixture(scope="module")
def counts(session: Path) -> dict[str, int]:
    with open_log(session) as log:
        found = {topic.name: topic.count for topic in log.topics}
    assert found.keys() <= topics().keys()
    assert len(found) > 18
    return found


def plain(message: Any) -> Any:
    """A decoded message of any library as nested tuples of fields and plain values; not-a-number equals itself."""
    if isinstance(message, np.ndarray):
        return tuple(map(plain, message.tolist()))
    if isinstance(message, (list, tuple)):
        return tuple(map(plain, message))
    if isinstance(message, float):
        return "nan" if math.isnan(message) else message
    if isinstance(message, (bool, int, str)):
        return message
    names = [item.name for item in fields(message)] if is_dataclass(message) else message.__slots__
    return tuple((name, plain(getattr(message, name))) for name in names if name.islower() and name[0] != "_")


def test_rerun_checks_and_converts_it(session: Path, counts: dict[str, int]) -> None:
    said = rerun(session.parent, "mcap", "check", str(session))
    rows = [line.split() for line in said.splitlines() if " /" in line]
    assert {row[3] for row in rows} == counts.keys()
    assert {row[0] for row in rows} == {"ok"}
    converted = session.with_suffix(".rrd")
    rerun(session.parent, "mcap", "convert", str(session), "-o", str(converted))
    entities = {str(chunk.entity_path) for chunk in RrdReader(converted).stream()}
    assert {name for name in counts if name not in entities} == set()


def test_rosbags_reads_every_message_of_every_topic(session: Path, counts: dict[str, int]) -> None:
    with open_log(session) as log, AnyReader([session]) as reader:
        ours = ((envelope.topic, log.decode(envelope)) for envelope in log.messages())
        found = Counter[str]()
        for (connection, _, data), (topic, message) in zip(reader.messages(), ours, strict=True):
            assert connection.topic == topic
            assert plain(reader.deserialize(data, connection.msgtype)) == plain(message)
            found[topic] += 1
    assert found == counts


def test_another_ros_2_decoder_finds_the_same_values(session: Path, counts: dict[str, int]) -> None:
    with open_log(session) as log, session.open("rb") as file:
        ours = ((envelope.topic, envelope.sequence, log.decode(envelope)) for envelope in log.messages())
        found = Counter[str]()
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        for (_, channel, record, theirs), (topic, sequence, message) in zip(decoded, ours, strict=True):
            assert (channel.topic, record.sequence) == (topic, sequence)
            assert plain(theirs) == plain(message), topic
            found[topic] += 1
    assert found == counts
