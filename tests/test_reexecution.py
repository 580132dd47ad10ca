"""Recorded sessions decided again by today's code: they agree, and what does not is shown."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import log_samples
import pytest
from cells import Palpate, cell_text, write_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from runtime import cli, registry
from runtime import messages as m
from runtime import topics as t
from runtime.declaration import declared, definition, type_name
from runtime.errors import LogError
from runtime.log.decoding import decoding_of
from runtime.log.file import open_log
from runtime.messages import typestore
from runtime.reexecution.differences import differences
from runtime.reexecution.reexecute import reexecute
from runtime.reexecution.verdict import DECISIONS, Verdict

GOLDEN = Path(__file__).parent / "golden"


@dataclass(frozen=True)
class Item:
    """A message of a log, as today's class."""

    topic: str
    sequence: int
    stamp: int
    message: Any


Change = Callable[[Item], Item | None]


def check(path: Path) -> Verdict:
    with open_log(path) as log:
        return reexecute(log)


@dataclass(frozen=True)
class Old:
    """A type as an older log defines it: today's fields without some, and with one that is gone today."""

    cls: type[Any]
    without: tuple[str, ...]

    @property
    def text(self) -> str:
        own = [line for line in definition(self.cls).splitlines() if not line.startswith("#")]
        kept = [line for line in own if line.split()[1] not in self.without]
        whole, _ = typestore().generate_msgdef(type_name(self.cls), ros_version=2)
        rest = whole.partition("=" * 80)[2]
        return "\n".join([*kept, "string gone"]) + "\n" + ("=" * 80 + rest if rest else "")


def optional(cls: type[Any]) -> tuple[str, ...]:
    """Fields with a default: those that a type was given later."""
    return tuple(
        item.name for item in fields(cls) if item.default is not MISSING or item.default_factory is not MISSING
    )


def changed(
    source: Path,
    target: Path,
    change: Change = lambda item: item,
    metadata: dict[str, dict[str, str]] | None = None,
    olds: dict[str, Old] | None = None,
) -> Path:
    """A copy of a log in which every message is what `change` makes of it, and which goes without it for None.

    Types stay defined as they are in the log, whatever today's are, but for those in `olds`, by topic.
    """
    with open_log(source) as log, target.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros2")
        for name, values in (log.metadata | (metadata or {})).items():
            writer.add_metadata(name, values)
        channels, stores = {}, {}
        for topic in log.topics:
            text = olds[topic.name].text if topic.name in (olds or {}) else topic.definition
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(text, topic.type))
            stores[topic.name] = store
            schema = writer.register_schema(topic.type, "ros2msg", text.encode())
            about = {"topic_type_hash": store.hash_rihs01(topic.type)}
            channels[topic.name] = writer.register_channel(topic.name, "cdr", schema, about)
        for envelope in log.messages():
            made = change(Item(envelope.topic, envelope.sequence, envelope.stamp, log.decode(envelope)))
            if made is not None:
                store = stores[made.topic]
                names = [name for name, _ in store.fielddefs[envelope.type][1]]
                held = SimpleNamespace(**{name: getattr(made.message, name, "something") for name in names})
                payload = bytes(store.serialize_cdr(held, envelope.type))
                writer.add_message(channels[made.topic], made.stamp, payload, made.stamp, made.sequence)
        writer.finish()
    return target


def cut(source: Path, target: Path, share: float) -> Path:
    target.write_bytes(source.read_bytes()[: int(share * source.stat().st_size)])
    return target


def counted(verdict: Verdict, column: str) -> dict[str, int]:
    return {name: getattr(tally, column) for name, tally in verdict.tallies.items() if getattr(tally, column)}


def said(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    code = cli.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.mark.parametrize("name", ["linear", "spiral", "hybrid", "meta", "bayes", "bayes-slide", "exhausted", "wired"])
def test_every_decision_of_the_golden_logs_is_made_again(name: str) -> None:
    """Where one fails on purpose, look at its `palpate replay --check` and make it anew with tests/golden/make.py."""
    verdict = check(GOLDEN / f"{name}.mcap")
    assert verdict.first is None
    with open_log(GOLDEN / f"{name}.mcap") as log:
        held = {topic.name: topic.count for topic in log.topics if topic.name in verdict.tallies}
        permits = [permit for _, permit in log.read(t.PERMIT)]
    assert counted(verdict, "compared") == held
    assert set(held) == {topic.name for topic in DECISIONS}
    assert {permit.granted for permit in permits[10:]} == {True, False}  # somebody reached into the light field


def test_another_processor_decides_the_same() -> None:
    """Linear algebra for the oldest processors, without fused or wide arithmetic: no more than rounding differs."""
    program = (
        "import sys\n"
        "from runtime.log.file import open_log\n"
        "from runtime.reexecution.reexecute import reexecute\n"
        "for path in sys.argv[1:]:\n"
        "    with open_log(path) as log:\n"
        "        print(path, reexecute(log).first)\n"
    )
    paths = sorted(map(str, GOLDEN.glob("*.mcap")))
    old = {"OPENBLAS_CORETYPE": "Prescott", "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512_SKX AVX2 FMA3"}
    done = subprocess.run(
        [sys.executable, "-c", program, *paths],
        check=False,
        env=os.environ | old,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.stdout.splitlines() == [f"{path} None" for path in paths], done.stdout + done.stderr


def test_every_strategy_that_ships_has_a_golden_log() -> None:
    shipped = {plugin.name for plugin in registry.installed() if plugin.group == registry.STRATEGIES}
    recorded = set()
    for path in GOLDEN.glob("*.mcap"):
        assert path.stat().st_size < 60_000
        with open_log(path) as log:
            recorded.add(log.metadata["palpate.session"]["strategy"])
    assert shipped <= recorded


def test_a_session_in_many_processes_is_made_again_with_the_command(tmp_path: Path) -> None:
    palpate = Palpate(tmp_path)
    script = '[safety]\ninterruptions = [{ at = "4 s", clear_after = "0.5 s", reset_after = "0.3 s" }]\n'
    cell = cell_text(holes=2, seed="6", strategy='"bayes"').replace("[safety]\n", script)
    done = palpate.launch(write_cell(tmp_path, cell))
    assert done.returncode == 0, done.stderr
    (log,) = palpate.logs()
    done = palpate.run("replay", log, "--check")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "decisions agree" in done.stdout
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith("/")]
    assert [row[0] for row in rows] == [topic.name for topic in DECISIONS]
    assert all(row[2:] == ["0", "0"] for row in rows)  # on the machine that decided it, bit for bit


def test_a_search_that_was_aborted_ends_as_it_did(tmp_path: Path) -> None:
    exhausted = GOLDEN / "exhausted.mcap"
    # No arm aborts an attempt when it is asked to: here the log says that it did.
    (given_up,) = [result for result in _messages(m.SearchResult, "exhausted") if result.ending == m.Ending.EXHAUSTED]
    aborted = changed(exhausted, tmp_path / "aborted.mcap", lambda item: _aborted(item, given_up))
    assert counted(check(aborted), "compared")[t.SEARCH_RESULT.name] == 2
    assert check(aborted).first is None


def _aborted(item: Item, given_up: m.SearchResult) -> Item:
    """The message as it would be, had the only attempt of a search been aborted: no evidence, another ending."""
    message, reason = item.message, "attempt 1 was aborted: a stop"
    if isinstance(message, m.SearchGoal | m.Belief):
        kept = [miss for miss in message.misses if (miss.board, miss.hole) != (given_up.board, given_up.hole)]
        message = replace(message, misses=kept)
    elif isinstance(message, m.Attempt) and message.search == given_up.search:
        message = replace(message, outcome=m.Outcome.ABORTED, reason="a stop")
    elif isinstance(message, m.SearchResult) and message.search == given_up.search:
        message = replace(message, ending=m.Ending.ABORTED, reason=reason)
    elif isinstance(message, m.Candidate) and message.search == given_up.search and message.exhausted:
        message = replace(message, reason=reason)
    return replace(item, message=message)


# A difference of each kind


def _nudged(topic: t.Topic[Any], sequence: int, nudge: Callable[[Any], Any]) -> Change:
    def change(item: Item) -> Item:
        if (item.topic, item.sequence) != (topic.name, sequence):
            return item
        return replace(item, message=nudge(item.message))

    return change


def _moved(candidate: m.Candidate, by: float) -> m.Candidate:
    return replace(candidate, proposal=replace(candidate.proposal, x=candidate.proposal.x + by))


def test_the_first_difference_is_shown_field_by_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = changed(GOLDEN / "meta.mcap", tmp_path / "x.mcap", _nudged(t.CANDIDATE, 3, lambda item: _moved(item, 1e-4)))
    with open_log(path) as log:
        envelope = next(item for item in log.messages([t.CANDIDATE.name]) if item.sequence == 3)
        candidate = log.decode(envelope)
    code, out, _ = said(capsys, "replay", path, "--check")
    assert code == 1
    lines = out.splitlines()
    row = next(line for line in lines if line.startswith(t.CANDIDATE.name))
    assert row.split()[1:3] == [str(len(list(_messages(m.Candidate, "meta")))), "1"]
    first = lines.index(
        f"the first difference: {t.CANDIDATE.name}, search {candidate.search}, candidate {candidate.number}, "
        f"at {envelope.stamp / 1e9:.3f} s"
    )
    head, only = lines[first + 1], lines[first + 2 :]
    assert head.split() == ["field", "recorded", "now"]
    [(name, unit, recorded, now)] = [line.split() for line in only if line]
    assert (name, unit, recorded) == ("proposal.x", "[m]", repr(candidate.proposal.x))
    assert float(now) == pytest.approx(candidate.proposal.x - 1e-4, abs=1e-9)


@pytest.mark.parametrize(
    ("topic", "nudge", "field"),
    [
        (t.SEARCH_GOAL, lambda goal: replace(goal, seed=goal.seed + 1), "seed"),
        (t.SEARCH_GOAL, lambda goal: replace(goal, prior=replace(goal.prior, xx=goal.prior.xx * 1.01)), "prior.xx"),
        (t.SEARCH_RESULT, lambda result: replace(result, duration=result.duration + 0.1), "duration"),
        (t.BELIEF, lambda belief: replace(belief, count=belief.count + 1), "count"),
        (t.PERMIT, lambda permit: replace(permit, reason="because"), "reason"),
    ],
)
def test_each_decider_is_held_to_its_words(
    tmp_path: Path, topic: t.Topic[Any], nudge: Callable[[Any], Any], field: str
) -> None:
    verdict = check(changed(GOLDEN / "spiral.mcap", tmp_path / "x.mcap", _nudged(topic, 2, nudge)))
    assert verdict.first is not None
    assert verdict.first.topic == topic.name
    assert field in {item.name for item in verdict.first.fields}


def test_the_moment_of_a_decision_counts_too(tmp_path: Path) -> None:
    def late(item: Item) -> Item:
        return replace(item, stamp=item.stamp + 1) if item.topic == t.BELIEF.name else item

    verdict = check(changed(GOLDEN / "linear.mcap", tmp_path / "x.mcap", late))
    assert verdict.first is not None
    assert [(item.name, item.unit) for item in verdict.first.fields] == [("(sent at)", "ns")]
    assert counted(verdict, "differing") == {t.BELIEF.name: 2}


def test_rounding_is_counted_and_no_difference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = changed(
        GOLDEN / "spiral.mcap", tmp_path / "x.mcap", _nudged(t.CANDIDATE, 2, lambda item: _moved(item, 4e-10))
    )
    assert counted(check(path), "rounding")[t.CANDIDATE.name] >= 1
    code, out, _ = said(capsys, "replay", path, "--check")
    assert code == 0
    assert "decisions agree" in out


def test_a_strategy_that_goes_on_or_ends_early_is_a_difference(tmp_path: Path) -> None:
    def with_budget(count: int) -> dict[str, dict[str, str]]:
        with open_log(GOLDEN / "spiral.mcap") as log:
            session = dict(log.metadata["palpate.session"])
        document = json.loads(session["settings"])
        document["strategies"] = {"spiral": {}}
        document["strategy"] = "linear"
        document["search"]["max_attempts"] = count
        return {"palpate.session": session | {"settings": json.dumps(document)}}

    verdict = check(changed(GOLDEN / "spiral.mcap", tmp_path / "x.mcap", lambda item: item, with_budget(20)))
    assert counted(verdict, "differing")[t.CANDIDATE.name] > 2
    assert t.PERMIT.name not in counted(verdict, "differing")


# What a log may lack


@settings(max_examples=8, deadline=None)
@given(share=st.floats(0.2, 0.99))
def test_a_log_that_is_cut_short_agrees_as_far_as_it_goes(
    tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    path = cut(GOLDEN / "hybrid.mcap", tmp_path_factory.mktemp("cut") / "x.mcap", share)
    try:
        verdict = check(path)
    except LogError as error:
        assert "\n" not in str(error)  # noqa: PT017 - a log may break off before its first message
        return
    assert verdict.first is None
    assert verdict.compared > 0
    assert sum(counted(verdict, "missing").values()) <= 3


def test_decisions_that_a_cut_log_does_not_reach_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def before_the_end(item: Item) -> Item | None:
        return None if item.topic in (t.SEARCH_RESULT.name, t.BELIEF.name) and item.sequence == 2 else item

    path = changed(GOLDEN / "linear.mcap", tmp_path / "x.mcap", before_the_end)
    code, out, _ = said(capsys, "replay", path, "--check")
    assert code == 0
    assert (
        f"the log ends before decisions that would follow, which is no difference: 1 of {t.SEARCH_RESULT.name}" in out
    )


@pytest.mark.parametrize(
    ("topic", "sequence", "compared", "words"),
    [
        (t.ATTEMPT, 2, {t.SEARCH_GOAL.name: 1, t.SEARCH_RESULT.name: 1}, "attempts of search"),
        (t.SEARCH_GOAL, 1, {}, "the goal of search"),
        (t.OSSD, 100, {t.SEARCH_GOAL.name: 2, t.BELIEF.name: 2}, f"message 100 of {t.OSSD.name}"),
        (t.PERMIT, 50, {t.PERMIT.name: 49}, "permit 50"),
    ],
)
def test_what_the_recorder_lost_is_told_and_what_rests_on_it_left_out(
    tmp_path: Path, topic: t.Topic[Any], sequence: int, compared: dict[str, int], words: str
) -> None:
    def lose(item: Item) -> Item | None:
        return None if (item.topic, item.sequence) == (topic.name, sequence) else item

    path = changed(
        GOLDEN / "meta.mcap",
        tmp_path / "x.mcap",
        lose,
        {"palpate.recording": {"lost_topics": json.dumps({topic.name: 1})}},
    )
    verdict = check(path)
    assert verdict.first is None, verdict.first
    assert any(words in reason for reason in verdict.losses), verdict.losses
    assert sum(counted(verdict, "beyond").values()) > 0
    for name, count in compared.items():
        assert verdict.tallies[name].compared == count


def test_a_log_that_begins_in_the_middle_is_compared_from_its_first_goal(tmp_path: Path) -> None:
    """As one that a recorder wrote which kept the last seconds only."""
    second = list(_messages(m.SearchGoal, "hybrid"))[1].header.stamp
    start = second.sec * 10**9 + second.nanosec
    verdict = check(
        changed(GOLDEN / "hybrid.mcap", tmp_path / "x.mcap", lambda item: item if item.stamp >= start else None)
    )
    assert verdict.first is None, verdict.first
    compared = counted(verdict, "compared")
    assert [compared[topic.name] for topic in (t.SEARCH_GOAL, t.SEARCH_RESULT, t.BELIEF)] == [1, 1, 1]
    assert compared[t.CANDIDATE.name] > 1
    assert counted(verdict, "beyond")[t.PERMIT.name] > 100


def test_the_loss_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def lose(item: Item) -> Item | None:
        return None if (item.topic, item.sequence) == (t.ATTEMPT.name, 3) else item

    lost = {"palpate.recording": {"lost_topics": json.dumps({t.ATTEMPT.name: 1})}}
    path = changed(GOLDEN / "meta.mcap", tmp_path / "x.mcap", lose, lost)
    code, out, _ = said(capsys, "replay", path, "--check")
    assert code == 0
    assert f"the recorder lost messages: 1 of {t.ATTEMPT.name}" in out
    assert "what rests on it cannot be compared" in out
    assert "decisions that can be compared agree" in out


def test_what_cannot_be_checked_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_log(GOLDEN / "meta.mcap") as log:
        session = log.metadata["palpate.session"]
    unknown = session | {"settings": json.dumps(json.loads(session["settings"]) | {"strategy": "tarot"})}

    def only_arm(item: Item) -> Item | None:
        return item if item.topic == t.ATTEMPT.name else None

    wrong = [
        (lambda item: item, {"palpate.session": unknown}, "no strategy 'tarot' is installed; known: bayes,"),
        (lambda item: item, {"palpate.session": {"session": "x"}}, "does not say with which settings"),
        (lambda item: item, {"palpate.session": session | {"settings": "{"}}, "are no JSON"),
        (only_arm, {}, "holds no decisions"),
    ]
    for number, (change, metadata, words) in enumerate(wrong):
        path = changed(GOLDEN / "meta.mcap", tmp_path / f"{number}.mcap", change, metadata)
        code, out, err = said(capsys, "replay", path, "--check")
        assert (code, out) == (2, "")
        assert words in err
        assert err.count("\n") == 1


# Definitions of other versions


def test_a_log_of_an_older_definition_is_read_and_checked(tmp_path: Path) -> None:
    olds = {
        t.PERMIT.name: Old(m.Permit, optional(m.Permit)),
        t.SEARCH_GOAL.name: Old(m.SearchGoal, ("layout",)),
        t.ATTEMPT.name: Old(m.Attempt, ("path",)),
    }
    path = changed(GOLDEN / "spiral.mcap", tmp_path / "old.mcap", olds=olds)
    with open_log(path) as log, open_log(GOLDEN / "spiral.mcap") as today:
        attempts = list(log.read(t.ATTEMPT))
        assert attempts == list(today.read(t.ATTEMPT))  # pecks have no path: its default is what was recorded
        goals = [goal for _, goal in log.read(t.SEARCH_GOAL)]
        assert all(goal.layout == [] and goal.seats for goal in goals)
        (envelope, *_) = log.messages([t.PERMIT.name])
        assert {"ossd", "resets"}.isdisjoint(log.recorded_fields(envelope)[m.Permit])
        with pytest.raises(LogError, match="defined it differently"):
            log.handle(t.PERMIT.name)
        assert log.handle(t.CANDIDATE.name) is t.CANDIDATE
    verdict = check(path)
    assert verdict.first is None, verdict.first
    assert counted(verdict, "compared") == counted(check(GOLDEN / "spiral.mcap"), "compared")


def test_a_field_that_nothing_can_stand_in_for_is_named(tmp_path: Path) -> None:
    path = changed(
        GOLDEN / "spiral.mcap", tmp_path / "old.mcap", olds={t.ATTEMPT.name: Old(m.Attempt, ("depth", "path"))}
    )
    with open_log(path) as log:
        with pytest.raises(LogError, match=r"/attempt: palpate_msgs/msg/Attempt .* differently: without depth"):
            list(log.read(t.ATTEMPT))
        assert list(log.read(t.OSSD))


def test_a_definition_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer: Any = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema("palpate_msgs/msg/Reset", "ros2msg", b"nothing at all!")
        channel = writer.register_channel(t.RESET.name, "cdr", schema, {"topic_type_hash": "RIHS01_" + "0" * 64})
        writer.add_message(channel, 7, b"\x00\x01\x00\x00", 7, 1)
        writer.finish()
    with open_log(path) as log, pytest.raises(LogError, match="its definition in the log cannot be read") as caught:
        list(log.read(t.RESET))
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_message_of_an_older_type_are_one_line(tmp_path: Path) -> None:
    path = changed(GOLDEN / "spiral.mcap", tmp_path / "old.mcap", olds={t.ATTEMPT.name: Old(m.Attempt, ("path",))})
    with open_log(path) as log:
        envelope = next(log.messages([t.ATTEMPT.name]))
        with pytest.raises(LogError, match=rf"/attempt at .*: 9 bytes are no {type_name(m.Attempt)}"):
            log.decode(replace(envelope, payload=envelope.payload[:9]))


# Field by field


def _messages(cls: type[Any], name: str = "bayes") -> Iterator[Any]:
    with open_log(GOLDEN / f"{name}.mcap") as log:
        for topic in log.topics:
            if topic.type == type_name(cls):
                yield from (message for _, message in log.read(t.topics()[topic.name]))


@pytest.mark.parametrize("cls", [m.SearchGoal, m.Belief, m.Candidate, m.Permit])
def test_a_message_does_not_differ_from_itself(cls: type[Any]) -> None:
    for message in _messages(cls):
        assert list(differences(message, replace(message))) == []


def test_differences_have_dotted_names_and_units() -> None:
    goal = next(iter(_messages(m.SearchGoal)))
    seats = [replace(goal.seats[0], x=goal.seats[0].x + 1e-3), *goal.seats[1:]]
    layout = [*goal.layout, m.Place("9", 0.0, 0.0)]
    found = list(differences(goal, replace(goal, seats=seats, layout=layout)))
    assert [(item.name, item.unit) for item in found] == [("seats[0].x", "m"), ("layout (how many)", "")]
    known = {m.SearchGoal: frozenset({"seats"}), m.Seat: frozenset({"hole"})}
    assert list(differences(goal, replace(goal, seats=seats, layout=layout), known)) == []


@given(st.floats(1e-9, 1e-6), st.floats(-1, 1))
def test_a_variance_is_compared_by_what_it_means(variance: float, change: float) -> None:
    """What counts as rounding is less than a nanometre of standard deviation wherever that exceeds 0.1 mm."""
    now = variance + change * 1e-12
    found = list(differences(m.Gaussian(xx=variance), m.Gaussian(xx=now)))
    wider = abs(now**0.5 - variance**0.5)
    if found and found[0].rounding and variance >= 1e-8:
        assert wider < 1e-9
    assert all(item.rounding for item in found) == (abs(now - variance) <= max(1e-13, 1e-9 * max(now, variance)))


def test_a_sample_without_decisions_of_ours_is_told_apart(tmp_path: Path) -> None:
    """A log that another program wrote under our names: its decisions are not ours, and that is a difference."""
    path = tmp_path / "sample.mcap"
    log_samples.record(path)
    verdict = check(path)
    assert verdict.first is not None
    assert counted(verdict, "differing")[t.CANDIDATE.name] > 0


def test_every_declared_type_can_lose_its_optional_fields() -> None:
    """The defaults of today's classes are what stands in for a field, for each of them."""
    for name, cls in declared().items():
        missing = optional(cls)
        if missing and len(missing) < len(fields(cls)):
            decoding = decoding_of(name, "cdr", Old(cls, missing).text, "RIHS01_" + "0" * 64)
            assert decoding.recorded[cls] == {item.name for item in fields(cls)} - set(missing)
