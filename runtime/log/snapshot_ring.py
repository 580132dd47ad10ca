"""A recording that stays in memory, until somebody asks for it or something fails."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from runtime import quantity
from runtime.bus import Envelope
from runtime.errors import InputError
from runtime.log.recording import Account, Latched, Opening
from runtime.log.writer import FLUSH_INTERVAL, SUMMARY, LogWriter
from runtime.messages import NANOSECONDS, SnapshotReply

SNAPSHOT = "palpate.snapshot"  # metadata record: number, reason, from and until in session time [ns]
RING_BYTES = 256 * 2**20  # [byte] that messages may take in memory; then the oldest make room
SPANS = (1.0, 3600.0)  # [s] least and greatest that can be kept
AFTERMATH = 1.0  # [s] of session time that is waited for after a failure
_OVERHEAD = 250  # [byte] that a message takes in memory besides its payload
_REASONS = 8  # that are told in one snapshot


def parse_span(text: str) -> float:
    """Read a stretch of session time [s]: `30`, `30s`, `2min`. Raises InputError that says what would do."""
    try:
        seconds = float(text) if text.replace(".", "", 1).isdigit() else quantity.parse(text, "time")
    except ValueError:
        seconds = 0.0
    if not SPANS[0] <= seconds <= SPANS[1]:
        raise InputError(f"--snapshot {text!r} is no time from {SPANS[0]:g} s to {SPANS[1]:g} s, such as 30 or 2min")
    return seconds


def snapshot_path(path: Path, number: int) -> Path:
    """File of a session's snapshot, from 1; `path` is where the whole session would be."""
    return path.with_name(f"{path.stem}-snapshot-{number}.mcap")


class RingRecording:
    """Keeps the last `seconds` of session time in memory, and what latched topics had said before.

    A failure is written down AFTERMATH later, or at the end of the session. Failures that follow closely share a file:
    after one such snapshot the next waits until as much time has passed as it can hold, so that a failure that comes
    again and again takes no more of the disk than a whole recording would.
    """

    def __init__(self, path: Path, opening: Opening, account: Account, seconds: float, limit: int = RING_BYTES) -> None:
        self._path = path
        self._opening = opening
        self._account = account
        self._span = round(seconds * NANOSECONDS)
        self._limit = limit  # [byte]
        self._ring: deque[Envelope] = deque()
        self._bytes = 0
        self._now = 0  # session time of the latest message [ns]
        self._latched = Latched()  # as of before the ring's first message
        self._number = 0  # of snapshots
        self._failures: list[str] = []  # that wait for their snapshot
        self._due_at = 0  # [ns] when it is to be written
        self._quiet_until = 0  # [ns] before which no other failure is written down

    def write(self, envelope: Envelope) -> None:
        """Take a message; what is too old or too much falls out."""
        ring = self._ring
        ring.append(envelope)
        self._bytes += len(envelope.payload) + _OVERHEAD
        self._now = max(self._now, envelope.stamp)
        oldest = self._now - self._span
        while ring[0].stamp < oldest or self._bytes > self._limit:
            gone = ring.popleft()
            self._bytes -= len(gone.payload) + _OVERHEAD
            self._latched.note(gone)
            if not ring:
                break

    def attach(self, name: str, text: str, media_type: str) -> None:
        """Attach to every snapshot from now on."""
        self._opening.attachments[name] = (text, media_type)

    def fail(self, reason: str) -> None:
        """Write a snapshot soon."""
        if not self._failures:
            self._due_at = max(self._now + round(AFTERMATH * NANOSECONDS), self._quiet_until)
        if reason not in self._failures and len(self._failures) < _REASONS:
            self._failures.append(reason)

    def snapshot(self, reason: str) -> SnapshotReply:
        """Write a snapshot now."""
        path, messages = self._write(reason or "asked for")
        return SnapshotReply(str(path.resolve()), messages, "")

    def tend(self) -> None:
        """Write down a failure when it is time."""
        if self._failures and self._now >= self._due_at:
            self._write_failures()

    @property
    def due(self) -> float:
        """Nothing is more urgent than this [s]."""
        return FLUSH_INTERVAL

    def finish(self) -> None:
        """Write down what failed at the end."""
        if self._failures and self._ring:
            self._write_failures()

    def close(self) -> None:
        """Nothing is open."""

    def _write_failures(self) -> None:
        reason, self._failures = "; ".join(self._failures), []
        self._quiet_until = self._now + self._span
        self._write(reason)

    def _write(self, reason: str) -> tuple[Path, int]:
        self._number += 1
        path = snapshot_path(self._path, self._number)
        first = self._ring[0].stamp if self._ring else self._now
        with LogWriter(path) as log:
            self._opening.write_to(log)
            log.add_metadata(
                SNAPSHOT,
                {"number": str(self._number), "reason": reason, "from": str(first), "until": str(self._now)},
            )
            self._latched.restate(log, first)
            for envelope in self._ring:
                log.write(envelope)
            log.add_metadata(SUMMARY, self._account(log.messages, log.undefined))
            return path, log.messages
