"""What an attended cell asks of a person, and which answers it takes. Pure: results and answers in, words out.

    a search ended without a find --> ask --> retry: the same hole, a fresh part, a new search
                                              skip:  the next hole
                                              abort: the job is over

One request is open at a time. An answer names the request that it is meant for, so that one which comes late, or twice,
does nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from runtime.messages import (
    AnswerGiven,
    Choice,
    Ending,
    Intervention,
    InterventionAnswer,
    InterventionReply,
    Need,
    SearchResult,
    header,
)
from runtime.messages.attendance import DROPPED_WORDS, JAM_WORDS, PROTECTIVE_STOP_WORDS

CHOICES = {choice.name.lower(): choice for choice in (Choice.RETRY, Choice.SKIP, Choice.ABORT)}

_SIGNS = ((DROPPED_WORDS, Need.DROPPED), (PROTECTIVE_STOP_WORDS, Need.PROTECTIVE_STOP), (JAM_WORDS, Need.JAM))
_TASKS = {
    Need.EXHAUSTED: "see whether the board lies as it should and hole {hole} is open; the part went to the reject bin",
    Need.DROPPED: "find the part that fell, and take it away if it lies on the board or under the arm",
    Need.PROTECTIVE_STOP: "see what the arm ran into and clear it away; the arm stands until you answer, "
    "then it goes up",
    Need.JAM: "look at hole {hole}: it may be closed, or a pin bent in it; the part was pulled out and went to the "
    "reject bin",
    Need.ABORTED: "see that nothing is in the arm's way at hole {hole}",
}
_RETRY = "the same hole again, with a fresh part"
_SKIP = "leave this hole, go on with the next"
_ABORT = "end the job here"


def need_of(result: SearchResult) -> Need:
    """What the end of a search asks of a person."""
    if result.ending == Ending.INSERTED:
        return Need.NOTHING
    if result.ending == Ending.EXHAUSTED:
        return Need.EXHAUSTED
    return next((need for words, need in _SIGNS if words in result.reason), Need.ABORTED)


def nothing_needed(now: int, before: Intervention | None = None) -> Intervention:
    """Word at session time `now` [ns] that nobody is waited for, any more or as yet."""
    if before is None:
        return Intervention(header(now), 0, Need.NOTHING, 0, 0, "", "", "", "", "", "")
    return replace(before, header=header(now), need=Need.NOTHING, task="", retry="", skip="", abort="")


@dataclass
class AttendanceDesk:
    """The requests of one session, and what became of them."""

    attended: bool
    open: Intervention = field(default_factory=lambda: nothing_needed(0))
    numbered: int = 0  # requests so far

    def ask(self, result: SearchResult, now: int) -> Intervention | None:
        """The request that follows from the end of a search, at session time `now` [ns]; None if it asks for nobody."""
        need = need_of(result)
        if need is Need.NOTHING or not self.attended:
            return None
        self.numbered += 1
        task = _TASKS[need].format(hole=result.hole)
        self.open = Intervention(
            header(now),
            self.numbered,
            need,
            result.search,
            result.board,
            result.hole,
            result.reason,
            task,
            _RETRY,
            _SKIP,
            _ABORT,
        )
        return self.open

    def hear(self, answer: InterventionAnswer, now: int) -> tuple[InterventionReply, AnswerGiven | None]:
        """What to reply to whoever answers at session time `now` [ns], and the answer if it is taken."""
        if answer.choice == Choice.LOOK:
            return InterventionReply(self.attended, "" if self.attended else _UNATTENDED, self.open), None
        error = self._refusal(answer)
        if error:
            return InterventionReply(False, error, self.open), None
        asked = self.open
        self.open = nothing_needed(now, asked)
        given = AnswerGiven(
            header(now), asked.number, asked.search, asked.board, asked.hole, answer.choice, answer.who, answer.note
        )
        return InterventionReply(True, "", self.open), given

    def _refusal(self, answer: InterventionAnswer) -> str:
        asked = self.open
        if not self.attended:
            return _UNATTENDED
        if answer.choice not in tuple(CHOICES.values()):
            return f"{answer.choice} is no answer; known: {_listed()}"
        if answer.number > self.numbered or answer.number == 0:
            return f"there is no request {answer.number}; {self._last_asked()}"
        if answer.number < self.numbered:
            return f"request {answer.number} is past; {self._last_asked()}"
        if asked.need == Need.NOTHING:
            return f"request {answer.number} has been answered; nothing is asked now"
        return ""

    def _last_asked(self) -> str:
        asked = self.open
        if asked.need != Need.NOTHING:
            return f"the open one is {asked.number}: board {asked.board} hole {asked.hole}"
        return "nothing is asked now"


_UNATTENDED = "this cell is unattended: it goes on by itself; `palpate launch --attended` asks"


def _listed() -> str:
    return ", ".join(f"{choice.value} {name}" for name, choice in CHOICES.items())


def told(request: Intervention) -> str:
    """A request in one line."""
    need = Need(request.need).name.lower().replace("_", " ")
    return f"board {request.board} hole {request.hole} needs a person: {need}: {request.reason}; {request.task}"


def answered(given: AnswerGiven) -> str:
    """An answer in one line."""
    note = f": {given.note}" if given.note else ""
    return f"board {given.board} hole {given.hole}: {Choice(given.choice).name.lower()}, said {given.who or '?'}{note}"
