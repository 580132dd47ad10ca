"""Starts a session as an operator would, follows it on the bus, and says when it closes."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from runtime.bus import Bus, Envelope
from runtime.clock import Stopwatch
from runtime.errors import BusError, SessionError
from runtime.intervention import answered
from runtime.messages import (
    NANOSECONDS,
    AnswerGiven,
    Choice,
    Intervention,
    InterventionAnswer,
    Log,
    Need,
    Permit,
    Phase,
    PublisherCounts,
    Reset,
    SearchResult,
    SessionState,
    header,
    stamp_of,
)
from runtime.network.admission import Admission
from runtime.roles import LAUNCHER
from runtime.topics import (
    ANSWER,
    ANSWER_GIVEN,
    ATTEMPT,
    COUNTS,
    INTERVENTION,
    PERMIT,
    RESET,
    ROSOUT,
    SEARCH_RESULT,
    SESSION,
)

LINGER = 0.05  # [s] of machine time: nobody reads a progress bar faster
_ANSWER_TIMEOUT = 10.0  # [s] of machine time for the assembly to take an answer


@dataclass
class Progress:
    """How far a session is, for whoever shows it."""

    searches: int
    done: int = 0
    attempts: int = 0
    board: int = 0
    hole: str = ""
    session_time: float = 0.0  # [s]
    permitted: bool = True
    said: list[Log] = field(default_factory=list)  # by the plugins, since the last look
    request: Intervention | None = None  # what an attended cell needs now
    answer: InterventionAnswer | None = None  # of whoever looks at this, to be handed on
    refusal: str = ""  # why the last one was not taken


@dataclass
class Session:
    """A session that ended: what came out, and where it is recorded."""

    name: str
    log: Path
    results: list[SearchResult] = field(default_factory=list)
    duration: float = 0.0  # session time [s]
    machine_time: float = 0.0  # [s] from the first permit to the last result
    interrupted: bool = False
    aborted: str = ""  # who ended the job, and where

    def snapshots(self) -> list[Path]:
        """The files that a recorder with a memory wrote, oldest first."""
        found = self.log.parent.glob(f"{self.log.stem}-snapshot-*.mcap")
        return sorted(found, key=lambda path: (len(path.name), path.name))


def begin(wait_until_ready: Callable[[], None]) -> SessionError | None:
    """Wait until all plugins are ready; why they never will be, if so."""
    try:
        wait_until_ready()
    except SessionError as error:
        return error
    return None


class FailedSessionError(SessionError):
    """A session that failed while it ran, with what it left."""

    def __init__(self, reason: str, session: Session) -> None:
        super().__init__(reason)
        self.session = session


class Follower:
    """The launcher's own voice and ear on the bus."""

    def __init__(
        self,
        bus: Bus,
        check: Callable[[], None],  # raises if a plugin has ended
        session: Session,
        searches: int,
        show: Callable[[Progress], None],
    ) -> None:
        self._bus = bus
        self._check = check
        self._session = session
        self._progress = Progress(searches)
        self._show = show
        self._now = 0  # session time [ns]
        self._started = self._done = False
        self._admission = Admission(self._complain, session=session.name)
        bus.inbox.admit_by(self._admission, self._admission.refuse)
        self._watch = Stopwatch()  # since the first permit
        self._resets = bus.publisher(RESET)
        self._states = bus.publisher(SESSION)
        self._counts = bus.publisher(COUNTS)
        bus.subscribe(PERMIT, SEARCH_RESULT, ATTEMPT, SESSION, ROSOUT, INTERVENTION, ANSWER_GIVEN)
        bus.announce()

    def _say(self, phase: Phase, text: str) -> None:
        self._states.send(SessionState(header(self._now), self._session.name, phase, text), self._now)

    def _complain(self, text: str) -> None:
        """Tell whoever watches the session."""
        line = Log(
            stamp=stamp_of(self._now), level=logging.WARNING, name=LAUNCHER, msg=text, file="", function="", line=0
        )
        self._progress.said.append(line)

    def count(self) -> None:
        """Tell the recorder how much this process has published."""
        self._counts.send(PublisherCounts(header(self._now), LAUNCHER, self._bus.counts()), self._now)

    def follow(self) -> None:
        """Follow the session to its end, or to KeyboardInterrupt, which it notes; then say that it closes or failed."""
        try:
            self._follow_job()
        except KeyboardInterrupt:
            self._session.interrupted = True
        except BaseException as error:
            self.fail(error)
            raise
        self._say(Phase.CLOSING, "interrupted" if self._session.interrupted else self._session.aborted or "closing")

    def see_through(self, failure: SessionError | None, close: Callable[[], None]) -> None:
        """Follow the session, unless it has failed to begin, and close it whatever happens."""
        try:
            if failure is not None:
                self.fail(failure)
                raise failure
            self.follow()
        except BaseException:
            with contextlib.suppress(SessionError):  # what failed first is what is told
                close()
            raise
        close()

    def fail(self, error: BaseException) -> None:
        """Say that the session failed, and why."""
        self._say(Phase.FAILED, str(error) or type(error).__name__)

    def _follow_job(self) -> None:
        """Start the job as an operator would, by a reset, and follow it until it is done."""
        self._say(Phase.STARTING, "waiting for the first permit")
        while not (self._done and self._progress.done == self._progress.searches):
            for item in self._bus.inbox.gather(timeout=0.2, linger=LINGER):
                if isinstance(item, Envelope):
                    self._take_note(item)
            self._check()
            self._show(self._progress)
            self._progress.said.clear()
            self._hand_on()

    def _hand_on(self) -> None:
        """Give the assembly what whoever follows this session has answered."""
        progress, answer = self._progress, self._progress.answer
        if answer is not None:
            progress.answer = None
            try:
                progress.refusal = self._bus.request(ANSWER, answer, _ANSWER_TIMEOUT).error
            except BusError as error:  # whoever waits can answer again
                progress.refusal = str(error)

    def _take_note(self, item: Envelope) -> None:
        self._now = max(self._now, item.stamp)
        self._progress.session_time = self._now / NANOSECONDS
        if item.topic == PERMIT.name:
            self._hear_permit(item.read(PERMIT))
        elif item.topic == ATTEMPT.name:
            attempt = item.read(ATTEMPT)
            self._progress.attempts += 1
            self._progress.board, self._progress.hole = attempt.board, attempt.hole
        elif item.topic == SEARCH_RESULT.name:
            self._session.results.append(item.read(SEARCH_RESULT))
            self._progress.done += 1
            self._session.duration = self._now / NANOSECONDS
            self._session.machine_time = self._watch.seconds
        elif item.topic == ROSOUT.name:
            self._progress.said.append(item.read(ROSOUT))
        elif item.topic == INTERVENTION.name:
            request = item.read(INTERVENTION)
            self._progress.request = None if request.need == Need.NOTHING else request
        elif item.topic == ANSWER_GIVEN.name:
            self._hear_answer(item.read(ANSWER_GIVEN))
        elif item.topic == SESSION.name:
            self._done = item.read(SESSION).phase == Phase.DONE

    def _hear_answer(self, given: AnswerGiven) -> None:
        """A retry is one more search to wait for; after an abort no more follow."""
        if given.choice == Choice.RETRY:
            self._progress.searches += 1
        elif given.choice == Choice.ABORT:
            self._progress.searches = self._progress.done
            self._session.aborted = f"the job was aborted: {answered(given)}"

    def _hear_permit(self, permit: Permit) -> None:
        """Press reset once the interlock asks for it at the beginning; start the job with the first permit."""
        self._progress.permitted = permit.granted
        if not self._started and permit.granted:
            self._started, self._watch = True, Stopwatch()
            self._say(Phase.RUNNING, "")
        elif not self._started:
            self._resets.send(Reset(header(self._now), LAUNCHER), self._now)
