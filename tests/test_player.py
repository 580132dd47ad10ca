"""A log that is played back arrives whole, in order and with its timing, and the player does as it is told."""

from __future__ import annotations

import contextlib
import copy
import math
import os
import signal
import socket
import subprocess
import sys
import termios
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import log_samples
import pytest
from cells import Palpate
from conftest import Meeting
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime import messages as m
from runtime import topics as t
from runtime.bus import Bus, Envelope, Inbox, Request
from runtime.cli import main
from runtime.clock import Stopwatch
from runtime.errors import BusError, InputError
from runtime.local_bus import LocalBus, LocalExchange
from runtime.log.file import LogFile, open_log
from runtime.log.writer import LogWriter
from runtime.network.zenoh_bus import ZenohBus, ZenohRouter
from runtime.playback.keys import KeyReader, command_of
from runtime.playback.playlist import Selection, parse_remap, playlist
from runtime.playback.state import ACTIONS, Playback, command
from runtime.player import Manner, Player, PlaySummary

PATIENCE = 30.0
FAST = Manner(rate=None)
FEW = Selection(include=("/search/*", "/attempt", t.SESSION.name, t.ARM_STATUS.name))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    log_samples.record(path)
    return path


@pytest.fixture
def log(path: Path) -> Iterator[LogFile]:
    with open_log(path) as log:
        yield log


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    with ZenohRouter(port):
        yield port


def play(log: LogFile, bus: Bus, selection: Selection | None = None, manner: Manner = FAST) -> PlaySummary:
    player = Player(log, bus, playlist(log, selection, clock=manner.clock is not None), manner)
    player.run()
    return player.summary


def take(inbox: Inbox, count: int) -> list[Envelope]:
    items = [inbox.receive(PATIENCE) for _ in range(count)]
    return [item for item in items if isinstance(item, Envelope)]


def arrived(bus: Bus) -> list[Envelope]:
    return take(bus.inbox, len(bus.inbox))


def content(envelopes: list[Envelope]) -> list[tuple[str, str, int, bytes]]:
    return [(item.topic, item.type, item.stamp, item.payload) for item in envelopes]


def listener(exchange: LocalExchange) -> LocalBus:
    bus = LocalBus(exchange, "recorder")
    bus.subscribe_all()
    return bus


def latched_before(log: LogFile, stamp: int, include: Callable[[str], bool] = lambda _: True) -> dict[str, Envelope]:
    """What latched topics last said, found the plain way."""
    return {
        item.topic: item
        for item in log.messages(None, None, stamp)
        if t.topics()[item.topic].latched and include(item.topic)
    }


@dataclass
class Running:
    """A player in a thread, and somebody who tells it what to do."""

    player: Player
    asker: Bus
    failures: list[BaseException] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            self.player.run()
        except BaseException as error:
            self.failures.append(error)

    def ask(self, action: str, value: float = 0.0) -> m.PlayerState:
        return self.asker.request(t.PLAYER_CONTROL, m.PlayerCommand(action, value), PATIENCE)

    def tell(self, action: str, value: float = 0.0) -> m.PlayerState:
        state = self.ask(action, value)
        assert state.ok, state.error
        return state

    def ends(self) -> bool:
        self._thread.join(PATIENCE)
        return not self._thread.is_alive()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread.is_alive():
            with contextlib.suppress(BusError):  # it may have ended meanwhile
                self.ask("quit")
        assert self.ends()
        assert not self.failures, self.failures


def running(
    log: LogFile, exchange: LocalExchange, selection: Selection | None = None, manner: Manner = FAST
) -> Running:
    what = playlist(log, selection, clock=manner.clock is not None)
    return Running(Player(log, LocalBus(exchange, "player"), what, manner), LocalBus(exchange, "operator"))


def until(condition: Callable[[], bool]) -> None:
    """Look again and again; each look asks another process or the bus."""
    watch = Stopwatch()
    while not condition():
        assert watch.seconds < PATIENCE


# What is played.


@pytest.mark.parametrize("attempt", range(2))
def test_every_message_arrives_in_order_over_zenoh(log: LogFile, port: int, attempt: int) -> None:
    expected = list(log.messages())
    with ZenohBus("recorder", port) as recorder:
        recorder.subscribe_all()
        recorder.announce()
        with ZenohBus("player", port) as bus:
            summary = play(log, bus)
            played = take(recorder.inbox, len(expected))
        assert not recorder.inbox.lost
    assert not summary.skipped
    assert summary.sent == summary.heard == Counter(item.topic for item in expected)
    for name in summary.sent:
        before = [item for item in expected if item.topic == name]
        after = [item for item in played if item.topic == name]
        assert content(after) == content(before)
        assert [item.sequence for item in after] == list(range(1, len(before) + 1))


def test_a_late_subscriber_gets_what_is_latched(log: LogFile, port: int) -> None:
    with ZenohBus("player", port) as bus:
        summary = play(log, bus, Selection(include=(t.ROBOT_DESCRIPTION.name, t.TF_STATIC.name)))
        with ZenohBus("viewer", port) as late:
            late.subscribe(t.ROBOT_DESCRIPTION, t.TF_STATIC)
            assert {item.topic for item in take(late.inbox, 2)} == {t.ROBOT_DESCRIPTION.name, t.TF_STATIC.name}
    assert (summary.sent.total(), summary.heard.total()) == (2, 0)


def test_it_waits_for_listeners_who_then_miss_nothing(log: LogFile, port: int) -> None:
    wanted = {t.ATTEMPT.name, t.ARM_STATUS.name}  # one of them latched
    what = playlist(log, Selection(listeners=(t.ATTEMPT.name, "/arm/sta*")))
    with ZenohBus("player", port) as bus, ZenohBus("operator", port) as asker, ZenohBus("viewer", port) as viewer:
        with Running(Player(log, bus, what, FAST), asker) as player:
            assert player.tell("state").sent == 0
            assert set(player.player.waiting_for.split(", ")) == wanted
            viewer.subscribe(t.ATTEMPT)
            until(lambda: player.player.waiting_for == t.ARM_STATUS.name)
            assert player.tell("state").sent == 0
            viewer.subscribe(t.ARM_STATUS)
            assert player.ends()
        summary = player.player.summary
        expected = list(log.messages(wanted))
        assert sorted(content(take(viewer.inbox, len(expected)))) == sorted(content(expected))
        assert not viewer.inbox.lost
    assert {name: summary.heard[name] for name in wanted} == {name: summary.sent[name] for name in wanted}
    assert set(summary.heard) == wanted


def test_anybody_will_do_if_no_topic_is_named(log: LogFile) -> None:
    exchange = LocalExchange()
    with running(log, exchange, Selection(listeners=())) as player:
        assert player.tell("state").sent == 0
        assert player.player.waiting_for == "any topic"
        LocalBus(exchange, "viewer").subscribe(t.TF)
        assert player.ends()
    assert set(player.player.summary.heard) == {t.TF.name}


def test_only_the_topics_asked_for_are_played(log: LogFile) -> None:
    exchange = LocalExchange()
    recorder = listener(exchange)
    selection = Selection(include=("/search/*", "/attempt"), exclude=("*/goal",))
    summary = play(log, LocalBus(exchange, "player"), selection)
    assert set(summary.sent) == {t.CANDIDATE.name, t.SEARCH_RESULT.name, t.ATTEMPT.name}
    assert len(recorder.inbox) == summary.sent.total()


def test_a_topic_is_played_under_another_name(log: LogFile, port: int) -> None:
    old = list(log.messages([t.ARM_STATUS.name]))
    selection = Selection(include=("/arm/status", "/attempt"), remap={"/arm/status": "/before/status"})
    renamed = playlist(log, selection).topics["/arm/status"]
    with ZenohBus("viewer", port) as viewer, ZenohBus("player", port) as bus:
        viewer.subscribe(renamed)
        summary = play(log, bus, selection)
        assert content(take(viewer.inbox, len(old))) == [("/before/status", *rest) for _, *rest in content(old)]
        with ZenohBus("late", port) as late:  # what was latched still is
            late.subscribe(renamed)
            assert take(late.inbox, 1)[0].payload == old[-1].payload
    assert set(summary.sent) == {"/before/status", "/attempt"}
    assert "/before/status" not in t.topics()


@pytest.mark.parametrize(
    ("selection", "said"),
    [
        (Selection(include=("/atempt",)), r"no topic .* matches '/atempt'; did you mean '/attempt'\?"),
        (Selection(exclude=("/nowhere",)), "no topic .* matches '/nowhere'"),
        (Selection(exclude=("*",)), "nothing is left"),
        (Selection(remap={"/atempt": "/x"}), r"--remap /atempt: .* did you mean '/attempt'"),
        (Selection(include=("/tf",), remap={"/attempt": "/x"}), "--remap /attempt: no such topic is played"),
        (Selection(remap={"/attempt": "/tf"}), "/attempt and /tf would both be published as /tf"),
        (Selection(remap={"/attempt": "/x", "/tf": "/x"}), "both be published as /x"),
        (Selection(listeners=("/nowhere",)), "--wait /nowhere"),
        (Selection(start=1e4), "--start 10000 is outside"),
        (Selection(start=-1e4), "--start -10000 is outside"),
        (Selection(start=2.0, end=2.0), "leaves nothing: what is played begins at 2 s"),
        (Selection(end=-1e4), "leaves nothing"),
    ],
)
def test_what_the_log_does_not_have_is_refused(log: LogFile, selection: Selection, said: str) -> None:
    with pytest.raises(InputError, match=said):
        playlist(log, selection)


def test_two_rules_for_one_clock_are_refused(log: LogFile) -> None:
    with pytest.raises(InputError, match="the player's clock and /attempt"):
        playlist(log, Selection(remap={"/attempt": "/clock"}), clock=True)


@pytest.mark.parametrize("rule", ["/a", "/a:=b", "a:=/b", "/a:=/b c", "/a:=/1", "/a:=/b/", "/a:=//b", ":=/b", "/a:=/ö"])
def test_a_rule_that_is_none_is_refused(rule: str) -> None:
    with pytest.raises(InputError, match=f"--remap '{rule}'"):
        parse_remap([rule])
    with pytest.raises(InputError, match="two names"):
        parse_remap(["/a:=/b", "/a:=/c"])
    assert parse_remap(["/a:=/b", "/c/_d:=/e1/f"]) == {"/a": "/b", "/c/_d": "/e1/f"}


@pytest.mark.parametrize(("start", "end"), [(2.0, None), (None, 1.0), (1.0, 2.0), (-1.0, None), (None, -0.5)])
def test_a_part_of_the_log_is_played_and_what_was_latched_before(
    log: LogFile, start: float | None, end: float | None
) -> None:
    exchange = LocalExchange()
    recorder = listener(exchange)
    play(log, LocalBus(exchange, "player"), Selection(start=start, end=end))
    first = log.start if start is None else round(start * 1e9) + (log.end if start < 0 else log.start)
    last = log.end + 1 if end is None else round(end * 1e9) + (log.end if end < 0 else log.start)
    played = arrived(recorder)
    early = [item for item in played if item.stamp < first]
    assert played[: len(early)] == early
    expected = latched_before(log, first)
    assert {item.topic: item.payload for item in early} == {name: item.payload for name, item in expected.items()}
    assert len(early) == len(expected)
    assert bool(early) == (start is not None)
    assert content(played[len(early) :]) == content(list(log.messages(None, first, last)))


def test_a_type_nobody_knows_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "unknown.mcap"
    with LogWriter(path) as writer:
        writer.write(Envelope("/radar", "acme_msgs/msg/Radar", b"\x00\x01\x00\x00\x07", 5, 1, bytes(16)))
        writer.write(Envelope("/note", "std_msgs/msg/String", b"\x00\x01\x00\x00\x01\x00\x00\x00\x00", 6, 1, bytes(16)))
    with open_log(path) as log:
        summary = play(log, LocalBus(LocalExchange(), "player"))
    assert summary.sent == {"/note": 1}
    assert "acme_msgs/msg/Radar" in summary.skipped["/radar"]
    assert "/note" not in t.topics()


# When it is played.


def test_it_takes_the_time_that_was_recorded(log: LogFile) -> None:
    rate = 20.0
    watch = Stopwatch()
    summary = play(log, LocalBus(LocalExchange(), "player"), manner=Manner(rate))
    assert watch.seconds > (log.end - log.start) / 1e9 / rate - 1e-3  # never early, however busy the machine is
    assert summary.until == log.end


def test_the_rate_changes_while_it_plays(log: LogFile) -> None:
    with running(log, LocalExchange(), manner=Manner(0.01)) as player:  # the log would take minutes
        assert player.tell("state").rate == 0.01
        watch = Stopwatch()
        begun = player.tell("rate", 20.0)
        assert player.tell("scale", 0.5).rate == 10.0
        player.tell("scale", 2.0)
        assert player.ends()
        assert watch.seconds > (begun.duration - begun.time) / 20.0 - 1e-3
    assert player.player.summary.until == log.end


def test_a_log_without_limit_of_rate_can_be_slowed_down(log: LogFile) -> None:
    with running(log, LocalExchange(), manner=replace(FAST, paused=True)) as player:
        assert player.tell("state").rate == math.inf
        assert "max cannot be scaled" in player.ask("scale", 0.5).error
        player.tell("rate", 0.01)
        assert player.tell("resume").time < 1.0
        player.tell("rate", math.inf)
        assert player.ends()


def test_a_pause_holds_and_loses_nothing(log: LogFile, meeting: Meeting) -> None:
    recorder, asker, bus = meeting.join("recorder"), meeting.join("operator"), meeting.join("player")
    recorder.subscribe_all()
    meeting.begin()
    expected = list(log.messages())
    with Running(Player(log, bus, playlist(log), Manner(2.0)), asker) as player:
        until(lambda: player.tell("state").sent > 20)
        held = player.tell("pause")
        taken = take(recorder.inbox, held.sent)
        assert held.paused
        assert [player.tell("state") for _ in range(20)] == [held] * 20
        assert recorder.inbox.receive(0.05) is None
        player.tell("rate", math.inf)
        assert player.tell("toggle").paused is False
        taken += take(recorder.inbox, len(expected) - held.sent)
        assert player.ends()
    assert sorted(content(taken)) == sorted(content(expected))
    assert not recorder.inbox.lost


def test_time_stands_still_in_a_pause(tmp_path: Path) -> None:
    """What is due 10 s after a pause in the middle of a gap is not due at once when it ends."""
    path = tmp_path / "gap.mcap"
    text = b"\x00\x01\x00\x00\x01\x00\x00\x00\x00"
    with LogWriter(path) as writer:
        for stamp in (0, 100_000_000_000):
            writer.write(Envelope("/note", "std_msgs/msg/String", text, stamp, 1, bytes(16)))
    with open_log(path) as log, running(log, LocalExchange(), manner=Manner(10.0)) as player:
        until(lambda: player.tell("state").time > 0.2)
        held = player.tell("pause")
        assert 0.2 < held.time < 100.0
        assert player.tell("resume").time == pytest.approx(held.time, abs=5.0)
        assert player.tell("skip", 20.0).time == pytest.approx(held.time + 20.0, abs=10.0)
        assert player.tell("state").sent == 1


def test_a_step_is_one_message(log: LogFile, meeting: Meeting) -> None:
    recorder, asker, bus = meeting.join("recorder"), meeting.join("operator"), meeting.join("player")
    recorder.subscribe_all()
    meeting.begin()
    expected = list(log.messages(playlist(log, FEW).topics))
    with Running(Player(log, bus, playlist(log, FEW), replace(FAST, paused=True)), asker) as player:
        stepped = []
        for count, item in enumerate(expected[:5], 1):
            state = player.tell("step")
            assert (state.sent, state.time) == (count, pytest.approx((item.stamp - log.start) / 1e9))
            stepped += take(recorder.inbox, 1)
            assert not len(recorder.inbox)
        assert player.tell("step", 3.0).sent == 8
        stepped += take(recorder.inbox, 3)
        assert content(stepped) == content(expected[:8])
        player.tell("resume")
        assert player.ends()
    assert content(take(recorder.inbox, len(expected) - 8)) == content(expected[8:])


def test_a_seek_in_a_pause_restores_what_was_latched(log: LogFile) -> None:
    exchange = LocalExchange()
    recorder = listener(exchange)
    with running(log, exchange, manner=replace(FAST, paused=True)) as player:

        @settings(max_examples=40, deadline=None)
        @given(st.integers(0, log.end - log.start), st.booleans())
        def anywhere(offset: int, relative: bool) -> None:
            arrived(recorder)
            if relative:
                stamp = log.start + offset
                player.tell("skip", (stamp - player.player.playback.position) / 1e9)
                stamp = player.player.playback.position  # to the nanosecond that floats allow
                assert abs(stamp - log.start - offset) <= 1
            else:
                player.tell("seek", offset / 1e9)
                stamp = log.start + offset
            restored = arrived(recorder)
            assert sorted(content(restored)) == sorted(content([*latched_before(log, stamp).values()]))
            assert [item.stamp for item in restored] == sorted(item.stamp for item in restored)
            player.tell("step")
            assert content(arrived(recorder)) == content([next(log.messages(None, stamp))])

        anywhere()
        assert not recorder.inbox.lost  # sequence numbers went on through all jumps


def test_it_stays_at_the_end_of_a_pause_and_may_go_back(log: LogFile) -> None:
    exchange = LocalExchange()
    recorder = listener(exchange)
    with running(log, exchange, FEW, replace(FAST, paused=True)) as player:
        duration = player.tell("state").duration
        last = player.tell("seek", duration)
        assert last.time == duration
        assert player.tell("step", 10.0).paused
        player.tell("seek", 0.0)
        arrived(recorder)
        player.tell("resume")
        assert player.ends()
    assert content(arrived(recorder)) == content(list(log.messages(playlist(log, FEW).topics)))


@pytest.mark.parametrize("start", [None, 2.0])
def test_a_loop_begins_again_until_it_is_ended(log: LogFile, start: float | None) -> None:
    exchange = LocalExchange()
    recorder = listener(exchange)
    selection = replace(FEW, start=start)
    once = play(log, LocalBus(exchange, "player"), selection)
    first = arrived(recorder)
    assert len(first) == once.sent.total()
    with running(log, exchange, selection, replace(FAST, loop=True)) as player:
        played = take(recorder.inbox, 3 * len(first))
        assert player.tell("quit").ok
    assert content(played) == 3 * content(first)
    last: dict[str, int] = {}
    for item in played:
        assert item.sequence == last.get(item.topic, 0) + 1
        last[item.topic] = item.sequence


def test_a_loop_without_messages_ends(log: LogFile) -> None:
    gap = next(item.stamp for item in log.messages([t.ATTEMPT.name])) / 1e9
    selection = Selection(include=(t.ATTEMPT.name,), start=0.1, end=gap / 2)
    assert not play(log, LocalBus(LocalExchange(), "player"), selection, replace(FAST, loop=True)).sent


def test_the_clock_follows_the_player(log: LogFile) -> None:
    exchange = LocalExchange()
    viewer = LocalBus(exchange, "viewer")
    viewer.subscribe(t.CLOCK)
    with running(log, exchange, manner=Manner(1.0, paused=True, clock=500.0)) as player:

        def told() -> list[float]:
            times = arrived(viewer)
            assert all(m.nanoseconds_of(item.read(t.CLOCK).clock) == item.stamp for item in times)
            return [item.stamp / 1e9 for item in times]

        player.tell("state")
        assert told() == [0.0]
        player.tell("seek", 1.0)
        assert told() == [1.0]
        assert player.tell("step").time == told()[0]
        player.tell("state")
        assert told() == []
        player.tell("resume")
        flowing = [item.stamp for item in take(viewer.inbox, 20)]
        assert flowing == sorted(flowing)
        assert set(flowing) - {item.stamp for item in log.messages([t.CLOCK.name])}
        player.tell("pause")
        told()
        assert [player.tell("state").paused for _ in range(10)] == [True] * 10
        assert told() == []
    assert t.CLOCK.name not in playlist(log, clock=True).topics


# How it is told.


def test_a_wrong_command_is_answered_with_what_is_wrong(log: LogFile, meeting: Meeting) -> None:
    asker, bus = meeting.join("operator"), meeting.join("player")
    meeting.begin()
    with Running(Player(log, bus, playlist(log, Selection(end=2.0)), Manner(0.01)), asker) as player:
        for action, value, said in [
            ("puase", 0.0, "did you mean 'pause'"),
            ("seek", 2.5, "outside of what is played, 0.000 to 2.000 s"),
            ("seek", math.nan, "outside"),
            ("skip", math.inf, "no number"),
            ("rate", 0.0, "neither max nor a number"),
            ("rate", math.nan, "neither max nor"),
            ("scale", -1.0, "neither max nor"),
            ("step", 1.0, "needs a pause"),
        ]:
            state = player.ask(action, value)
            assert not state.ok
            assert said in state.error
            assert (state.paused, state.rate) == (False, 0.01)
        assert player.tell("pause").error == ""
        assert "no number of messages" in player.ask("step", 0.5).error
        assert player.tell("quit").ok
        assert player.ends()


def test_bytes_that_are_no_command_are_answered(log: LogFile) -> None:
    exchange = LocalExchange()
    replies: list[bytes] = []
    with running(log, exchange, manner=Manner(paused=True)) as player:
        exchange.servers[t.PLAYER_CONTROL.name].put(Request(t.PLAYER_CONTROL.name, b"junk", replies.append))
        player.tell("state")
    assert b"4 bytes are no palpate_msgs/msg/PlayerCommand" in replies[0]


@given(
    st.lists(
        st.one_of(
            st.tuples(st.sampled_from([*ACTIONS, "fly"]), st.floats() | st.floats(-20.0, 20.0) | st.integers(0, 3)),
            st.tuples(st.none(), st.integers(0, 10_000_000_000)),
        ),
        max_size=30,
    ),
    st.integers(0, 4_000_000_000),
    st.integers(1, 4_000_000_000),
    st.booleans(),
)
def test_commands_keep_a_playback_in_its_bounds(
    events: list[tuple[str | None, float]], start: int, length: int, paused: bool
) -> None:
    playback = Playback(0, 9_000_000_000, start, start + length, paused=paused)
    stamp = playback.jump()
    for action, value in events:
        before = copy.copy(playback)
        if action is None:
            diverted, held = playback.diverted, playback.paused and not playback.steps
            if playback.target is not None and not playback.quitting:
                stamp = playback.jump()
                assert playback.paused == before.paused
            elif playback.releases(stamp, int(value)):
                assert not diverted
                assert not held
                assert playback.position == stamp
                stamp = min(stamp + 1_000_000, playback.until - 1)
        else:
            try:
                playback.obey(m.PlayerCommand(action, float(value)))
            except InputError:
                assert playback == before
        assert start <= playback.position < playback.until
        assert playback.target is None or start <= playback.target < playback.until
        assert playback.rate is None or 0.01 <= playback.rate <= 1000.0
        assert not (playback.steps and not playback.paused)
        assert playback.state(playback.position).paused == playback.paused


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("jump",), "cannot 'jump'"),
        (("seek",), "needs a VALUE"),
        (("pause", "3"), "takes no value"),
        (("skip", "far"), "no number"),
        (("rate", "quick"), "'max' nor a number"),
    ],
)
def test_words_that_are_no_command_are_refused(words: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        command(*words)


def test_words_become_commands() -> None:
    assert command("rate", "max") == m.PlayerCommand("rate", math.inf)
    assert command("skip", "-5") == m.PlayerCommand("skip", -5.0)
    assert command("step") == m.PlayerCommand("step", 0.0)


# The keyboard.

KEYS = {
    b"\x1b[A": "up", b"\x1bOB": "down", b"\x1b[C": "right", b"\x1bOD": "left", b"\x1b[H": "home", b"\x1b[1~": "home",
    b" ": " ", b"s": "s", b"0": "0", b"q": "q", b"\x1bq": "q", b"\x1b[5~": "", b"\x1b[1;5C": "", "ä".encode(): "",
}  # fmt: skip


@given(st.lists(st.sampled_from(sorted(KEYS)), max_size=12), st.data())
def test_keys_are_read_however_their_bytes_are_cut(sent: list[bytes], data: st.DataObject) -> None:
    whole = b"".join(sent)
    cuts = sorted(data.draw(st.sets(st.integers(0, len(whole)), max_size=6)))
    reader = KeyReader()
    pieces = [whole[a:b] for a, b in zip([0, *cuts], [*cuts, len(whole)], strict=True)]
    assert [key for piece in pieces for key in reader.feed(piece)] == [KEYS[each] for each in sent if KEYS[each]]


@given(st.binary(max_size=40))
def test_every_key_is_a_command_that_a_player_knows_or_none(data: bytes) -> None:
    for key in KeyReader().feed(data):
        meant = command_of(key)
        assert meant is None or meant.action in ACTIONS


BEGIN = (
    "import fcntl, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    "from runtime.cli import main; sys.exit(main(sys.argv[1:]))"
)


@dataclass
class Terminal:
    """palpate in a terminal of its own."""

    palpate: Palpate
    shown: bytearray = field(default_factory=bytearray)

    def start(self, *arguments: str | Path) -> None:
        self.master, self.slave = os.openpty()
        termios.tcsetwinsize(self.slave, (24, 120))
        self.before = termios.tcgetattr(self.slave)
        self.process = subprocess.Popen(
            [sys.executable, "-c", BEGIN, *map(str, arguments), "--port", str(self.palpate.port)],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            cwd=self.palpate.folder,
            env={**os.environ, "TERM": "xterm"},
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        while data := os.read(self.master, 4096):
            self.shown += data
            if data.endswith(b"\0"):
                return

    def raw(self) -> bool:
        return not termios.tcgetattr(self.slave)[3] & termios.ICANON

    def press(self, keys: bytes) -> None:
        os.write(self.master, keys)

    def end(self) -> tuple[int, str]:
        """Exit code, and all that was shown."""
        code = self.process.wait(PATIENCE)
        os.write(self.slave, b"\0")
        self._reader.join(PATIENCE)
        assert termios.tcgetattr(self.slave) == self.before
        os.close(self.slave)
        os.close(self.master)
        return code, self.shown.decode()


def asked(port: int, action: str = "state") -> m.PlayerState | None:
    """A player's state; None if there is none yet."""
    try:
        with ZenohBus("operator", port, patience=2.0) as bus:
            return bus.request(t.PLAYER_CONTROL, m.PlayerCommand(action, 0.0), PATIENCE)
    except BusError:
        return None


def test_the_keyboard_leads_a_replay(path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(Palpate(tmp_path))
    port = terminal.palpate.port

    def reaches(condition: Callable[[m.PlayerState], bool]) -> None:
        until(lambda: (state := asked(port)) is not None and condition(state))

    terminal.start("replay", path, "--paused")
    reaches(lambda state: state.paused and state.sent == 0)
    assert terminal.raw()
    terminal.press(b"sss")
    reaches(lambda state: state.sent == 3)
    terminal.press(b"\x1b[C")
    reaches(lambda state: state.time == 5.0)
    terminal.press(b"\x1b[D")
    reaches(lambda state: state.time == 0.0)
    terminal.press(b"\x1b[A\x1b[A\x1b[B\x1b[B\x1b[B\x1b[B")
    reaches(lambda state: state.rate == 0.25)
    terminal.press(b"0")
    reaches(lambda state: state.time == 0.0)
    terminal.press(b" ")
    reaches(lambda state: not state.paused and state.time > 0.0)
    assert main(["player", "pause", "--port", str(port)]) == 0
    assert capsys.readouterr().out.startswith("paused")
    assert main(["player", "seek", "1e6", "--port", str(port)]) == 2
    assert "outside of what is played" in capsys.readouterr().err
    terminal.press(b"q")
    code, shown = terminal.end()
    assert code == 0
    assert "space pause" in shown
    assert "listened to" in shown.rsplit("topic", 1)[1]
    with ZenohRouter(port):  # the port is free
        assert main(["player", "state", "--port", str(port)]) == 1
    assert f"nothing is played on port {port}" in capsys.readouterr().err


@pytest.mark.parametrize("by", ["Ctrl-C", "SIGTERM"])
def test_an_interrupted_replay_leaves_the_terminal_as_it_was(path: Path, tmp_path: Path, by: str) -> None:
    terminal = Terminal(Palpate(tmp_path))
    chosen = ["--topics", "/search/*", "--exclude", "*/result", "--remap", "/search/goal:=/goal", "--clock", "100"]
    terminal.start("replay", path, "--loop", "--rate", "0.5", "--start", "-4", "--end", "-1", *chosen)
    until(lambda: asked(terminal.palpate.port) is not None)
    assert terminal.raw()
    if by == "Ctrl-C":
        terminal.press(b"\x03")
    else:
        terminal.process.send_signal(signal.SIGTERM)
    code, shown = terminal.end()
    assert code == 130
    assert "interrupted" in shown
    table = shown.rsplit("topic", 1)[1]
    assert "/clock" in table
    assert "/search/result" not in table
    assert "\x1b[?25h" in shown  # the cursor is back
    with ZenohRouter(terminal.palpate.port):
        pass
