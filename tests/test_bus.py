"""One contract for every bus, and what only Zenoh has."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest
from conftest import Meeting

from runtime.bus import Bus, Envelope, Inbox, Request, encode
from runtime.errors import BusError, InputError
from runtime.messages import (
    ArmStatus,
    Belief,
    BeliefRequest,
    Candidate,
    Gaussian,
    Log,
    Ossd,
    Proposal,
    Reset,
    header,
    stamp_of,
)
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.topics import ARM_STATUS, ASK_BELIEF, CANDIDATE, OSSD, RESET, ROSOUT, TRUTH

PATIENCE = 20.0


def candidate(number: int) -> Candidate:
    belief = Gaussian(1.0, 2.0, 3.0, 4.0, 5.0)
    return Candidate(header(number), 1, number, False, "", Proposal(number * 1e-6, -1e-3, 0.5, belief))


def next_envelope(bus: Bus) -> Envelope:
    item = bus.inbox.receive(PATIENCE)
    assert isinstance(item, Envelope), item
    return item


def test_messages_arrive_complete_and_in_order(meeting: Meeting) -> None:
    sender, receiver = meeting.join("strategy"), meeting.join("arm")
    publisher = sender.publisher(CANDIDATE)
    receiver.subscribe(CANDIDATE)
    meeting.begin()
    for number in range(1, 501):
        publisher.send(candidate(number), stamp=number * 1000)
    for number in range(1, 501):
        envelope = next_envelope(receiver)
        assert envelope.read(CANDIDATE) == candidate(number)
        assert (envelope.sequence, envelope.stamp) == (number, number * 1000)
    assert not receiver.inbox.lost
    assert [(count.topic, count.sent) for count in sender.counts()] == [(CANDIDATE.name, 500)]


def test_everything_reaches_a_recorder(meeting: Meeting) -> None:
    sender, recorder = meeting.join("strategy"), meeting.join("recorder")
    first, second = sender.publisher(CANDIDATE), sender.publisher(ROSOUT)
    recorder.subscribe_all()
    meeting.begin()
    first.send(candidate(1), 1)
    second.send(Log(stamp=stamp_of(2), level=20, name="strategy", msg="µ", file="", function="", line=0), 2)
    arrived = {envelope.topic: envelope for envelope in (next_envelope(recorder), next_envelope(recorder))}
    assert set(arrived) == {CANDIDATE.name, ROSOUT.name}
    assert arrived[ROSOUT.name].read(ROSOUT).msg == "µ"
    assert arrived[CANDIDATE.name].publisher != arrived[ROSOUT.name].publisher


def test_a_late_subscriber_gets_the_last_latched_message(meeting: Meeting) -> None:
    sender, late = meeting.join("arm"), meeting.join("viewer")
    publisher = sender.publisher(ARM_STATUS)
    meeting.begin()
    for activity in ("home", "pick"):
        publisher.send(ArmStatus(header(0), 7, 1, 1.0, activity, ""), 0)
    late.subscribe(ARM_STATUS)
    assert next_envelope(late).read(ARM_STATUS).activity == "pick"


def test_a_question_is_answered(meeting: Meeting) -> None:
    asker, server = meeting.join("assembly"), meeting.join("posterior")
    server.serve(ASK_BELIEF)
    meeting.begin()

    def answer() -> None:
        item = server.inbox.receive(PATIENCE)
        assert isinstance(item, Request)
        asked = item.read(ASK_BELIEF)
        item.reply(Belief(header(3), "board", asked.hole, asked.after_search, Gaussian(1.0, 2.0, 3.0, 4.0, 5.0), []))

    thread = threading.Thread(target=answer)
    thread.start()
    reply = asker.request(ASK_BELIEF, BeliefRequest("7", 0, 11), timeout=PATIENCE)
    thread.join()
    assert (reply.hole, reply.count, reply.distribution) == ("7", 11, Gaussian(1.0, 2.0, 3.0, 4.0, 5.0))


def test_a_question_that_nobody_answers_is_an_error(meeting: Meeting) -> None:
    asker = meeting.join("assembly")
    meeting.begin()
    with pytest.raises(BusError, match="posterior"):
        asker.request(ASK_BELIEF, BeliefRequest("7", 0, 0), timeout=0.2)


@pytest.mark.parametrize("role", ["strategy", "posterior", "assembly", "interlock"])
def test_the_truth_is_hidden(meeting: Meeting, role: str) -> None:
    with pytest.raises(BusError, match="hidden"):
        meeting.join(role).subscribe(TRUTH)


def test_closing_twice_does_no_harm(meeting: Meeting) -> None:
    bus = meeting.join("strategy")
    bus.close()
    bus.close()


def test_reading_as_another_topic_is_refused() -> None:
    envelope = Envelope(RESET.name, "palpate_msgs/msg/Reset", encode(Reset(header(1), "me")), 1, 1, b"")
    assert envelope.read(RESET).source == "me"
    with pytest.raises(BusError, match="read as one of"):
        envelope.read(CANDIDATE)


def test_bytes_that_are_no_message_are_refused() -> None:
    whole = encode(candidate(1))
    for payload in (b"", whole[:-3], whole[:4], b"\xff" * 40, whole + b"12345678"):
        with pytest.raises(BusError):
            Envelope(CANDIDATE.name, "", payload, 1, 1, b"").read(CANDIDATE)


def test_an_inbox_counts_what_never_arrived() -> None:
    inbox = Inbox()
    for publisher, sequence in ((b"a", 1), (b"b", 3), (b"a", 2), (b"a", 6), (b"b", 4)):
        inbox.put(Envelope("/t", "", b"", 0, sequence, publisher))
    assert inbox.lost == {"/t": 2 + 3}
    assert inbox.received == {("/t", b"a"): 3, ("/t", b"b"): 2}


def test_a_port_in_use_is_said_in_one_line(free_port: int) -> None:
    with ZenohRouter(free_port):
        with pytest.raises(InputError, match=f"port {free_port}"):
            ZenohRouter(free_port)
        with ZenohBus("arm", free_port) as bus:
            bus.announce()


def test_a_bus_without_a_router_is_an_error(free_port: int) -> None:
    with pytest.raises(BusError, match=str(free_port)):
        ZenohBus("arm", free_port, patience=0.3)


def test_foreign_messages_are_dropped_and_counted(free_port: int) -> None:
    program = f"""
import zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:{free_port}"]')
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    session.put("0/some/thing", b"junk")
    session.put("0/attempt/palpate_msgs::msg::dds_::Attempt_/RIHS01_0", b"junk")
    session.put("0/attempt/palpate_msgs::msg::dds_::Attempt_/RIHS01_0", b"junk", attachment=b"short")
"""
    with ZenohRouter(free_port) as router, ZenohBus("recorder", free_port) as bus, ZenohBus("arm", free_port) as arm:
        bus.subscribe_all()
        publisher = arm.publisher(RESET)
        bus.announce()
        assert router.wait_for({"recorder"}, PATIENCE) == set()
        subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
        publisher.send(Reset(header(1), "after the junk"), 1)
        assert next_envelope(bus).read(RESET).source == "after the junk"
        assert bus.inbox.malformed == 3


def test_only_three_files_import_zenoh_and_what_measures_it() -> None:
    root = Path(__file__).parent.parent
    importing = [
        path.relative_to(root).as_posix()
        for folder in ("runtime", "drivers", "strategies")
        for path in (root / folder).rglob("*.py")
        if any(line.startswith(("import zenoh", "from zenoh")) for line in path.read_text().splitlines())
    ]
    assert sorted(importing) == [
        "runtime/benchmark/raw_zenoh.py",
        "runtime/network/zenoh_bus.py",
        "runtime/network/zenoh_exchange.py",
        "runtime/network/zenoh_session.py",
    ]


def test_topics_of_one_sender_arrive_in_the_order_in_which_they_were_sent(meeting: Meeting) -> None:
    sender, receiver = meeting.join("light_curtain"), meeting.join("interlock")
    resets, outputs = sender.publisher(RESET), sender.publisher(OSSD)
    receiver.subscribe(RESET, OSSD)
    meeting.begin()
    for number in range(1, 301):
        resets.send(Reset(header(number), ""), 2 * number)
        outputs.send(Ossd(header(number), True, True, stamp_of(number)), 2 * number + 1)
    arrived = [next_envelope(receiver).stamp for _ in range(600)]
    assert arrived == sorted(arrived)
