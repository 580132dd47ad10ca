"""Where a recording goes: into one file or several in a row."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from runtime.bus import Envelope
from runtime.log.split import CONTINUED, PART, Split, part_path
from runtime.log.writer import SUMMARY, LogWriter
from runtime.messages import NANOSECONDS, SnapshotReply
from runtime.topics import topics


@dataclass
class Opening:
    """What every file of a session begins with."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # records by name
    attachments: dict[str, tuple[str, str]] = field(default_factory=dict)  # text and media type by file name

    def write_to(self, log: LogWriter) -> None:
        """Begin a file; what is written here is in it at once."""
        for name, values in self.metadata.items():
            log.add_metadata(name, values)
        for name, (text, media_type) in self.attachments.items():
            log.attach(name, text, media_type)


@dataclass
class Latched:
    """What each publisher of each latched topic last said."""

    last: dict[tuple[str, bytes], Envelope] = field(default_factory=dict)

    def note(self, envelope: Envelope) -> None:
        """Keep a message if its topic is latched."""
        topic = topics().get(envelope.topic)
        if topic is not None and topic.latched:
            self.last[envelope.topic, envelope.publisher] = envelope

    def restate(self, log: LogWriter, stamp: int) -> None:
        """Repeat what is kept at session time `stamp` [ns], oldest first."""
        for envelope in sorted(self.last.values(), key=lambda item: item.stamp):
            log.restate(envelope, stamp)


class Recording(Protocol):
    """Keeps the messages of a session. Raises SessionError where a file cannot be written."""

    def write(self, envelope: Envelope) -> None:
        """Take a message."""
        ...

    def attach(self, name: str, text: str, media_type: str) -> None:
        """Take an attachment."""
        ...

    def fail(self, reason: str) -> None:
        """Something went wrong in the cell."""
        ...

    def snapshot(self, reason: str) -> SnapshotReply:
        """Somebody asks for what is kept in memory."""
        ...

    def tend(self) -> None:
        """Do what is due; called several times a second."""
        ...

    @property
    def due(self) -> float:
        """Seconds of machine time until `tend` has something to do."""
        ...

    def finish(self) -> None:
        """Write what is to be written at the end, when nothing more is to come."""
        ...

    def close(self) -> None:
        """Close the files. Idempotent."""
        ...


class Account(Protocol):
    """Tells what a file's summary says, for so many messages and those of them whose types are not known."""

    def __call__(self, messages: int, undefined: Counter[str]) -> dict[str, str]:
        """Values of the metadata record SUMMARY."""
        ...


class FileRecording:
    """Writes every message at once, into one file or into parts."""

    def __init__(self, path: Path, opening: Opening, account: Account, split: Split | None = None) -> None:
        self._path = path
        self._opening = opening
        self._account = account
        self._split = split
        self._latched = Latched()
        self._number = 1
        self._messages = 0  # in the parts before this one
        self._undefined: Counter[str] = Counter()
        self._began: int | None = None  # session time of the part's first message [ns]
        self._log = LogWriter(path)
        opening.write_to(self._log)

    def write(self, envelope: Envelope) -> None:
        """Write a message, into the next part if this one is full."""
        if self._split is not None:
            if self._began is None:
                self._began = envelope.stamp
            elif self._split.reached(self._log.size, (envelope.stamp - self._began) / NANOSECONDS):
                self._continue(envelope.stamp)
            self._latched.note(envelope)
        self._log.write(envelope)

    def _continue(self, stamp: int) -> None:
        """Close the part and go on in another."""
        following = part_path(self._path, self._number + 1)
        self._log.add_metadata(CONTINUED, {"file": following.name, **self._so_far()})
        self._log.close()
        self._messages += self._log.messages
        self._undefined.update(self._log.undefined)
        self._number, self._began = self._number + 1, stamp
        self._log = LogWriter(following)
        self._opening.write_to(self._log)
        self._log.add_metadata(PART, {"part": str(self._number), "first": self._path.name})
        self._latched.restate(self._log, stamp)

    def attach(self, name: str, text: str, media_type: str) -> None:
        """Attach to this part and to those that follow."""
        self._opening.attachments[name] = (text, media_type)
        self._log.attach(name, text, media_type)

    def fail(self, reason: str) -> None:
        """Everything is in the file in any case."""

    def snapshot(self, reason: str) -> SnapshotReply:  # noqa: ARG002 - none would do
        """Refuse: everything is in the file in any case."""
        return SnapshotReply(
            "",
            0,
            f"this session is recorded whole, in {self._path.resolve()}; only one that was started with "
            "'palpate launch --snapshot SECONDS' keeps messages in memory until somebody asks",
        )

    def tend(self) -> None:
        """Flush when it is due."""
        self._log.flush_if_due()

    @property
    def due(self) -> float:
        """Seconds until the next flush."""
        return self._log.due

    def finish(self) -> None:
        """Write the summary."""
        self._log.add_metadata(SUMMARY, self._so_far())

    def _so_far(self) -> dict[str, str]:
        return self._account(self._messages + self._log.messages, self._undefined + self._log.undefined)

    def close(self) -> None:
        """Close the file."""
        self._log.close()
