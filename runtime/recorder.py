"""Records everything that travels on the bus; at the end the file says what it holds and what never arrived."""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from runtime.bus import Envelope, Request
from runtime.clock import Stopwatch
from runtime.context import Context
from runtime.errors import BusError, SessionError
from runtime.log.failure import failure_in
from runtime.log.ledger import Ledger
from runtime.log.recording import FileRecording, Opening, Recording
from runtime.log.snapshot_ring import RingRecording
from runtime.log.split import Split
from runtime.log.writer import definition_of
from runtime.messages import Phase, SnapshotReply
from runtime.network.access import RECORDER
from runtime.topics import COUNTS, ROBOT_DESCRIPTION, SESSION, SNAPSHOT
from runtime.validity import fault

DESCRIPTION_FILE = "robot_description.urdf"  # attachment
BACKLOG = 5_000  # messages that may wait before senders are held up: a tenth of a second of work, lost if it is killed
LINGER = 0.02  # [s] of machine time in which messages gather before they are written together
QUIET = 2.0  # [s] of machine time without an arrival after which nothing more is expected
DRAIN_LIMIT = 15.0  # [s] of machine time for which a stopped recorder goes on receiving at most
_GREETED = 100  # types, for a stranger can make up any number
_SAID = frozenset({Phase.DONE, Phase.CLOSING, Phase.FAILED})  # phases in which a session may end


@dataclass(frozen=True)
class Recorder:
    """Writes every message of the session to MCAP files.

    With `snapshot` the last so many seconds of session time stay in memory, and are written down when somebody asks
    (the service SNAPSHOT) or something fails (`runtime.log.failure`, or a launcher that vanished without a word).
    """

    path: Path
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # records by name
    attachments: dict[str, str] = field(default_factory=dict)  # texts by file name
    split: Split | None = None
    snapshot: float | None = None  # [s] of session time

    def run(self, context: Context) -> None:
        """Record until stopped, then until everything that was sent has arrived."""
        ledger = Ledger(context.bus.inbox)
        recording = self._recording(ledger)
        try:
            context.bus.subscribe_all(BACKLOG)
            context.bus.serve(SNAPSHOT)
            context.ready()
            taken = _Taken(recording, ledger, context, watches=self.snapshot is not None)
            while not context.stopping:
                taken.next(recording.due)
            taken.drain()
        finally:
            recording.close()

    def _recording(self, ledger: Ledger) -> Recording:
        def account(messages: int, undefined: Counter[str]) -> dict[str, str]:
            lost = ledger.lost()
            return {
                "messages": str(messages),
                "lost": str(sum(lost.values())),
                "lost_topics": json.dumps(lost),
                "unsigned_topics": json.dumps(ledger.unsigned()),
                "undefined_types": json.dumps(dict(undefined)),
            }

        attachments = {name: (text, "text/plain") for name, text in self.attachments.items()}
        opening = Opening(dict(self.metadata), attachments)
        if self.snapshot is not None:
            return RingRecording(self.path, opening, account, self.snapshot)
        return FileRecording(self.path, opening, account, self.split)


class _Taken:
    """What has come out of the inbox so far."""

    def __init__(self, recording: Recording, ledger: Ledger, context: Context, *, watches: bool) -> None:
        self._recording = recording
        self._ledger = ledger
        self._context = context
        self._watches = watches  # for failures
        self._described = False
        self._over = False  # whether the launcher has said that the session ends
        self._types: set[str] = set()  # that were seen
        self._failing: dict[str, str] = {}  # what the last message of a topic said had failed
        self._looks: dict[str, Callable[[Envelope], None]] = {
            COUNTS.name: self._hear_counts,
            ROBOT_DESCRIPTION.name: self._hear_description,
            SESSION.name: self._hear_phase,
        }

    def next(self, timeout: float) -> bool:
        """Record what arrives next, if anything does within `timeout` seconds."""
        items = self._context.bus.inbox.gather(timeout, LINGER)
        clock, write, looks, types = self._context.clock, self._recording.write, self._looks, self._types
        for item in items:
            if isinstance(item, Envelope):
                if item.stamp > clock.now:
                    clock.advance(item.stamp)
                if item.topic == COUNTS.name:
                    # Last words come from every plugin, each by its own clock: they are stamped as they arrive.
                    write(replace(item, stamp=clock.now))
                else:
                    write(item)
                if item.topic in looks:
                    self._read(item, looks[item.topic])
                if self._watches:
                    self._read(item, self._watch)
                if item.type not in types:
                    self._greet(item)
            else:
                self._answer(item)
        self._recording.tend()
        return bool(items)

    def _read(self, item: Envelope, look: Callable[[Envelope], None]) -> None:
        try:
            look(item)
        except BusError as error:
            self._context.admission.refuse(item.topic, str(error))

    def _hear_counts(self, item: Envelope) -> None:
        counts = item.read(COUNTS)
        if wrong := fault(counts):
            raise BusError(wrong)
        self._ledger.note(counts.plugin, counts.counts)

    def _hear_description(self, item: Envelope) -> None:
        if not self._described:
            self._recording.attach(DESCRIPTION_FILE, item.read(ROBOT_DESCRIPTION).data, "application/xml")
            self._described = True

    def _hear_phase(self, item: Envelope) -> None:
        self._over = item.read(SESSION).phase in _SAID

    def _watch(self, item: Envelope) -> None:
        failure = failure_in(item)
        if failure and failure != self._failing.get(item.topic):
            self._recording.fail(failure)
        self._failing[item.topic] = failure

    def _greet(self, item: Envelope) -> None:
        """Look at the first message of a type."""
        self._types.add(item.type)
        if not definition_of(item.type) and len(self._types) <= _GREETED:
            self._context.log(
                f"{item.topic} carries {item.type}, which palpate does not know: recorded without its definition",
                logging.WARNING,
            )

    def _answer(self, request: Request) -> None:
        try:
            question = request.read(SNAPSHOT)
        except BusError as error:
            request.reply(SnapshotReply("", 0, str(error)))
            return
        try:
            request.reply(self._recording.snapshot(question.reason))
        except SessionError as error:
            request.reply(SnapshotReply("", 0, str(error)))
            raise

    def drain(self) -> None:
        """Receive until nothing more is to come, and write down what is missing."""
        inbox = self._context.bus.inbox
        own = [count for count in self._context.bus.counts() if count.topic != COUNTS.name]
        self._ledger.note(RECORDER, own)
        total, quiet = Stopwatch(), Stopwatch()
        while (
            not (self._ledger.complete() and not len(inbox)) and quiet.seconds < QUIET and total.seconds < DRAIN_LIMIT
        ):
            if self.next(0.05):
                quiet = Stopwatch()
        while len(inbox):  # the limit was reached, but what is here is here
            self.next(0.0)
        if lost := self._ledger.lost():
            what = ", ".join(f"{topic} {count}" for topic, count in lost.items())
            self._recording.fail(f"messages were lost on the way to the recorder: {what}")
        if not self._over:
            self._recording.fail("the launcher ended without a word")
        self._recording.finish()
