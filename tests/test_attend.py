"""A cell that waits for a person: what it asks, which answers it takes, and what comes of them."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from cells import Palpate, cell_text, write_cell
from command_line import CommandLine
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from test_player import Terminal

from runtime import config
from runtime import messages as m
from runtime import topics as t
from runtime.bus import Envelope
from runtime.errors import BusError
from runtime.follower import Progress, Session
from runtime.in_process import run_in_process
from runtime.intervention import AttendanceDesk, need_of
from runtime.launcher import Order
from runtime.log.file import open_log
from runtime.messages import Choice, Ending, InterventionAnswer, Need
from runtime.network.zenoh_bus import ZenohBus
from runtime.reexecution.reexecute import reexecute

NO_ERROR = {
    name: '"0 mm"' if "rotation" not in name else '"0 mrad"'
    for name in ("board_shift", "board_rotation", "hole_bias", "part_scatter", "part_rotation")
}
ATTENDED = '\n[attendance]\nmode = "attended"\n'
QUICK = '\n[drivers.mujoco_ur3e]\nfidelity = "fast"\n'
ANSWERS = (Choice.RETRY, Choice.SKIP, Choice.ABORT)


def perfect_cell(holes: int, mishaps: str, attendance: str = ATTENDED) -> str:
    """A cell in which the first attempt seats every part, but for what goes wrong."""
    extra = f"{QUICK}mishaps = [{mishaps}]\n{attendance}"
    return cell_text(holes=holes, strategy='"spiral"', extra=extra, **NO_ERROR)


def run(folder: Path, text: str, *choices: Choice) -> Session:
    """Run a cell in this process, where one after the other is answered."""
    cell_file = config.load(str(write_cell(folder, text)))
    left = list(choices)
    answered = [0]

    def show(progress: Progress) -> None:
        request = progress.request
        assert not progress.refusal
        if request is not None and request.number > answered[0]:
            answered[0] = request.number
            progress.answer = InterventionAnswer(request.number, left.pop(0), "anna", "")

    session = run_in_process(Order(cell_file, folder / "logs"), show)
    assert not left
    return session


def endings(session: Session) -> list[tuple[int, str, Ending]]:
    return [(result.search, result.hole, Ending(result.ending)) for result in session.results]


def asked(session: Session) -> list[m.Intervention]:
    with open_log(session.log) as log:
        return [request for _, request in log.read(t.INTERVENTION) if request.need != Need.NOTHING]


def check_again(session: Session) -> None:
    """Today's code decides the same on what was recorded, answers included."""
    with open_log(session.log) as log:
        verdict = reexecute(log)
    assert verdict.first is None
    assert verdict.losses == []
    tally = verdict.tallies[t.INTERVENTION.name]
    assert (tally.missing, tally.beyond) == (0, 0)
    assert tally.compared == 1 + 2 * len(asked(session))


def test_an_exhausted_search_is_tried_again_left_or_the_end_as_a_person_says(tmp_path: Path) -> None:
    text = cell_text(holes=3, max_attempts="1", hole_bias='"3 mm"', strategy='"linear"', extra=QUICK + ATTENDED)
    session = run(tmp_path, text, Choice.RETRY, Choice.SKIP, Choice.ABORT)
    exhausted = Ending.EXHAUSTED
    assert endings(session) == [(1, "1", exhausted), (2, "1", exhausted), (3, "2", exhausted)]
    assert session.aborted == "the job was aborted: board 1 hole 2: abort, said anna"
    assert [(request.number, request.need) for request in asked(session)] == [(n, Need.EXHAUSTED) for n in (1, 2, 3)]
    with open_log(session.log) as log:
        parts = [truth for _, truth in log.read(t.TRUTH)]
        phases = [state.text for _, state in log.read(t.SESSION) if state.phase == m.Phase.DONE]
        given = [(answer.number, answer.choice, answer.who) for _, answer in log.read(t.ANSWER_GIVEN)]
    assert parts[0].hole == parts[1].hole
    assert (parts[0].hole_x, parts[0].hole_y) == (parts[1].hole_x, parts[1].hole_y)
    assert (parts[0].pin_x, parts[0].pin_y) != (parts[1].pin_x, parts[1].pin_y)  # a fresh part
    assert phases == ["the job was aborted at board 1 hole 2"]
    assert given == [(1, Choice.RETRY, "anna"), (2, Choice.SKIP, "anna"), (3, Choice.ABORT, "anna")]
    check_again(session)


@pytest.mark.parametrize(
    ("kind", "need", "words"),
    [
        ("drop", Need.DROPPED, "the part was dropped"),
        ("push", Need.PROTECTIVE_STOP, "protective stop"),
        ("jam", Need.JAM, r"the part is jammed 1\.\d\d mm deep"),
    ],
)
def test_what_goes_wrong_is_told_and_a_retry_fills_the_hole(tmp_path: Path, kind: str, need: Need, words: str) -> None:
    session = run(tmp_path, perfect_cell(1, f'{{ kind = "{kind}", search = 1 }}'), Choice.RETRY)
    assert endings(session) == [(1, "1", Ending.ABORTED), (2, "1", Ending.INSERTED)]
    (request,) = asked(session)
    assert (request.need, request.board, request.hole, request.search) == (need, 1, "1", 1)
    assert re.search(words, request.reason)
    with open_log(session.log) as log:
        statuses = [status for _, status in log.read(t.ARM_STATUS)]
        answer = next(stamp for stamp, _ in log.read(t.ANSWER_GIVEN))
        released = [stamp for stamp, status in log.read(t.ARM_STATUS) if status.activity == "recover"]
        said = [line.msg for _, line in log.read(t.ROSOUT) if line.name == "assembly"]
    activities = [status.activity for status in statuses]
    assert ("recover" in activities) == (kind == "push")
    assert ("discard" in activities) == (kind != "drop")  # there is nothing to put away
    assert all(stamp >= answer for stamp in released)  # the arm stands until somebody has looked
    assert said[-1] == "board 1 hole 1: retry, said anna"
    assert any(line.startswith("board 1 hole 1 needs a person: ") for line in said)
    check_again(session)


def test_a_job_that_is_aborted_at_a_protective_stop_leaves_the_arm_as_it_stands(tmp_path: Path) -> None:
    session = run(tmp_path, perfect_cell(1, '{ kind = "push", search = 1 }'), Choice.ABORT)
    assert endings(session) == [(1, "1", Ending.ABORTED)]
    with open_log(session.log) as log:
        last = [status for _, status in log.read(t.ARM_STATUS)][-1]
    assert last.safety_mode == 3
    check_again(session)


def test_an_unattended_cell_copes_by_itself(tmp_path: Path) -> None:
    mishaps = ", ".join(f'{{ kind = "{kind}", search = {n} }}' for n, kind in enumerate(("drop", "push", "jam"), 1))
    session = run(tmp_path, perfect_cell(3, mishaps, attendance=""))
    # A jammed part has been pulled out again, so the search goes on with it.
    assert endings(session) == [(1, "1", Ending.ABORTED), (2, "2", Ending.ABORTED), (3, "3", Ending.INSERTED)]
    assert (asked(session), session.aborted) == ([], "")
    with open_log(session.log) as log:
        assert [truth.search for _, truth in log.read(t.TRUTH)] == [1, 2, 3]
        assert reexecute(log).first is None


def joined(terminal: Terminal) -> ZenohBus:
    while True:
        assert terminal.process.poll() is None, terminal.shown
        with contextlib.suppress(BusError):
            return ZenohBus("operator", terminal.palpate.port, patience=1.0)


def next_request(bus: ZenohBus, number: int) -> m.Intervention:
    while True:
        item = bus.inbox.receive(60.0)
        assert isinstance(item, Envelope)
        request = item.read(t.INTERVENTION)
        if request.number == number and request.need != Need.NOTHING:
            return request


def test_answers_in_the_terminal_over_zenoh_and_by_the_command(tmp_path: Path) -> None:
    terminal, here = Terminal(Palpate(tmp_path)), CommandLine(tmp_path)
    palpate, port = terminal.palpate, ("--port", str(terminal.palpate.port))
    text = cell_text(holes=2, max_attempts="1", hole_bias='"3 mm"', strategy='"linear"', extra=QUICK)
    terminal.start("launch", write_cell(tmp_path, text), "--attended")
    with joined(terminal) as bus:
        bus.subscribe(t.INTERVENTION)
        next_request(bus, 1)
        for number, choice, refused in (
            (7, Choice.RETRY, "there is no request 7; the open one is 1: board 1 hole 1"),
            (0, Choice.SKIP, "there is no request 0; the open one is 1: board 1 hole 1"),
            (1, 9, "9 is no answer; known: 1 retry, 2 skip, 3 abort"),
        ):
            reply = bus.request(t.ANSWER, InterventionAnswer(number, choice, "bob", ""), 10.0)
            assert (reply.accepted, reply.error, reply.open.number) == (False, refused, 1)
        shown = here.run("attend", *port)
        assert shown.returncode == 0, shown.stderr
        assert "request 1: board 1 hole 1: exhausted" in shown.stdout
        assert "the same hole again, with a fresh part" in shown.stdout
        assert "\x1b" not in shown.stdout
        assert bus.request(t.ANSWER, InterventionAnswer(1, Choice.RETRY, "bob", ""), 10.0).accepted
        next_request(bus, 2)
        late = here.run("attend", "skip", "--number", "1", *port)
        assert late.returncode == 2
        assert late.stderr == "palpate: request 1 is past; the open one is 2: board 1 hole 1\n"
        skipped = here.run("attend", "skip", "--wait", "--who", "anna", "--note", "closed hole", *port)
        assert (skipped.returncode, skipped.stdout) == (0, "board 1 hole 1: skip, said anna: closed hole\n")
        next_request(bus, 3)
        while b"request 3" not in terminal.shown or b"then Enter" not in terminal.shown.split(b"request 3")[-1]:
            assert terminal.process.poll() is None
        terminal.press(b"x\na no more parts\n")
        code, seen = terminal.end()
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen)
    assert code == 1
    assert "'x' is no answer; known: abort, retry, skip" in plain
    assert re.search(r"palpate: the job was aborted: board 1 hole 2: abort, said \S+: no more parts\s", plain), plain
    assert "0 of 2 igbts inserted" in plain
    checked = here.run("replay", palpate.logs()[0], "--check")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    gone = here.run("attend", *port)
    assert gone.returncode == 1
    assert gone.stderr.count("\n") == 1
    assert "is 'palpate launch --attended' there?" in gone.stderr


@pytest.mark.parametrize(
    ("arguments", "wrong"),
    [
        (("attend", "jump"), "'jump' is no answer; known: abort, retry, skip"),
        (("launch", "igbt", "--attended", "--in-process"), "is answered in its terminal, and there is none"),
    ],
)
def test_what_cannot_be_answered_is_said(tmp_path: Path, arguments: tuple[str, ...], wrong: str) -> None:
    done = CommandLine(tmp_path).run(*arguments)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert wrong in done.stderr


def result(ending: Ending, reason: str = "", search: int = 1) -> m.SearchResult:
    nothing = float("nan")
    return m.SearchResult(
        m.header(0), search, 1, "1", "igbt", ending, reason, 1, nothing, nothing, nothing, nothing, 1.0
    )


@given(st.sampled_from(Ending), st.text(max_size=40))
def test_who_has_inserted_a_part_needs_nobody(ending: Ending, reason: str) -> None:
    assert (need_of(result(ending, reason)) is Need.NOTHING) == (ending is Ending.INSERTED)


class People(RuleBasedStateMachine):
    """Whatever people say, and how often: each request is answered once, and by an answer that is meant for it."""

    def __init__(self) -> None:
        super().__init__()
        self.desk = AttendanceDesk(True)
        self.open = 0
        self.numbered = 0
        self.taken: list[int] = []

    @rule()
    def fail(self) -> None:
        if not self.open:
            request = self.desk.ask(result(Ending.EXHAUSTED), 0)
            assert request is not None
            self.numbered += 1
            self.open = request.number

    @rule(number=st.integers(0, 6), choice=st.integers(0, 5))
    def answer(self, number: int, choice: int) -> None:
        reply, given = self.desk.hear(InterventionAnswer(number, choice, "", ""), 0)
        meant = number == self.open != 0 and choice in ANSWERS
        assert (given is not None) == meant
        assert reply.accepted == (meant or choice == Choice.LOOK)
        assert (reply.error == "") == reply.accepted
        if given is not None:
            self.taken.append(given.number)
            self.open = 0

    @invariant()
    def one_answer_each(self) -> None:
        assert self.taken == list(range(1, self.numbered + 1))[: len(self.taken)]
        assert (self.desk.open.need != Need.NOTHING) == bool(self.open)


TestPeople = People.TestCase
TestPeople.settings = settings(max_examples=30, stateful_step_count=20)


def test_nobody_is_asked_in_an_unattended_cell() -> None:
    desk = AttendanceDesk(False)
    assert desk.ask(result(Ending.EXHAUSTED), 0) is None
    reply, given = desk.hear(InterventionAnswer(1, Choice.RETRY, "", ""), 0)
    assert (reply.accepted, given) == (False, None)
    assert "unattended" in reply.error
