"""Cells that share what they learnt: each keeps a store of its own, answers from it, and they come to hold the same.

A cell announces the checksum of what it knows: after each search, and every few seconds, since announcements may be
lost. Whoever knows something else asks it for what it lacks, in batches, until nothing new comes. Evidence is known by
its identity, so that it counts once, however often and by whatever way it comes. There is no order and no leader; a
cell that was cut off catches up with the first announcement that reaches it, and the others with its own.

Nothing here holds the cell up: all waiting is done in threads of the exchange.
"""

from __future__ import annotations

import hashlib
import logging
import queue
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from runtime.clock import Stopwatch
from runtime.closing import Closing
from runtime.errors import BusError, InputError, PalpateError
from runtime.evidence.digest import digest_from
from runtime.evidence.evidence import Evidence, evidence_from, text_of
from runtime.evidence.store import PosteriorStore

INTERVAL = 2.0  # [s] between announcements while nothing happens
ANSWER_TIMEOUT = 5.0  # [s] for a peer to answer
LAST_WORDS = 1.0  # [s] for the others to fetch what was found last, when a cell closes
_BATCH = 100  # searches in one answer
_LONGEST = 16_000_000  # bytes of an answer or a question that are looked at
_QUIET = 5.0  # [s] between two reports of the same kind
_PRESENT = 3 * INTERVAL  # [s] after its last announcement that a peer counts as there
_REMEMBERED = 60.0  # [s] after which a silent peer is forgotten: each session is a new one


class Peers(Protocol):
    """The other cells, as a transport reaches them. Methods raise BusError where they cannot."""

    @property
    def reached(self) -> bool:
        """Whether the place where they meet is reached."""
        ...

    def announce(self, checksum: str) -> None:
        """Tell all what checksum this cell's evidence has."""
        ...

    def ask(self, cell: str, question: bytes, timeout: float) -> bytes | None:
        """One cell's answer to a question; None if there was none within `timeout` seconds."""
        ...

    def close(self) -> None:
        """Leave. Idempotent."""
        ...


class Ears(Protocol):
    """What a transport tells. Its callbacks come from threads of the transport."""

    def heard(self, cell: str, checksum: bytes) -> None:
        """A cell has announced itself."""
        ...

    def asked(self, question: bytes) -> bytes:
        """The answer to a question. Raises InputError if it is none."""
        ...

    def misheard(self, what: str) -> None:
        """Something arrived that no cell of this version says."""
        ...


Join = Callable[[str, Ears], Peers]  # a cell's name and ears -> its peers; BusError if they cannot be reached now


@dataclass
class _Peer:
    """What is known of another cell."""

    checksum: str = ""  # that it announced last
    taken: str = ""  # up to which all it has was taken over
    given: str = ""  # checksum of our evidence when it had been given all it lacked
    since: Stopwatch = field(default_factory=Stopwatch)  # its last announcement


_CHANGED = ""  # in the queue of work, where the other items are names of cells


class EvidenceExchange(Closing):
    """Keeps one store in step with those of other cells, from its making until it is closed.

    With `at_once`, what `join` raises is raised here; else it is tried again until it works.
    """

    def __init__(self, store: PosteriorStore, cell: str, join: Join, where: str, *, at_once: bool = False) -> None:
        self._store, self._cell, self._join = store, cell, join
        self._work: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._announced: dict[str, str] = {}  # checksums by cell that are yet to be followed
        self._peers: dict[str, _Peer] = {}
        self._lock = threading.Lock()
        self._settled = threading.Condition(self._lock)
        self._checksum, self._revision = "", (-1, -1)
        self._reports = _Reports(where)
        self._closing = threading.Event()
        self._others = join(cell, self) if at_once else None  # None: not joined yet
        self._thread = threading.Thread(target=self._run, name="evidence exchange", daemon=True)
        self._thread.start()

    def changed(self) -> None:
        """The store has something new to announce."""
        self._work.put(_CHANGED)

    def reports(self, *, last: bool = False) -> list[tuple[str, int]]:
        """What happened since the last call, as text and level of `logging`; each kind at most every few seconds.

        With `last`, all of it.
        """
        return self._reports.due(last)

    def close(self) -> None:
        """Let the others fetch what was found last, but wait for it no longer than a second; then leave."""
        self._work.put(_CHANGED)
        watch = Stopwatch()
        with self._settled:
            while self._others is not None and not self._all_given() and watch.seconds < LAST_WORDS:
                self._settled.wait(LAST_WORDS - watch.seconds)
            self._closing.set()
            others = self._others
        self._work.put(_CHANGED)
        if others is not None:  # else one is being made, and closed as soon as it is
            others.close()  # which ends a question that waits for its answer, too
            self._thread.join(ANSWER_TIMEOUT)

    # What the transport tells

    def heard(self, cell: str, checksum: bytes) -> None:
        """A cell has announced itself."""
        if len(checksum) != _CHECKSUM or not checksum.isalnum():
            self.misheard("an announcement that is no checksum")
        elif cell != self._cell:
            with self._lock:
                waiting = cell in self._announced
                self._announced[cell] = checksum.decode()
            if not waiting:
                self._work.put(cell)

    def asked(self, question: bytes) -> bytes:
        """What the asker lacks, as lines of JSON. Raises InputError if the question is no digest."""
        name, _, text = question[:_LONGEST].partition(b"\n")
        digest = digest_from(text)
        if self._closing.is_set():  # the store may be closed by now
            return b""
        checksum = self._own_checksum()
        lacking = self._store.lacking(digest, _BATCH)
        if not lacking:
            with self._settled:
                self._peers.setdefault(name.decode(errors="replace"), _Peer()).given = checksum
                self._settled.notify_all()
        return "".join(f"{text_of(item)}\n" for item in lacking).encode()

    def misheard(self, what: str) -> None:
        """Something arrived that no cell of this version says."""
        self._reports.drop(what)

    # The exchange's own thread

    def _run(self) -> None:
        peers = self._joined() if self._others is None else self._others
        if peers is None:
            return
        try:
            while not self._closing.is_set():
                self._step(peers)
        finally:
            peers.close()

    def _joined(self) -> Peers | None:
        while not self._closing.is_set():
            try:
                peers = self._join(self._cell, self)
                with self._lock:
                    if not self._closing.is_set():
                        self._others = peers
                return peers
            except PalpateError as error:
                self._reports.reach(str(error))
                self._closing.wait(INTERVAL)
        return None

    def _step(self, peers: Peers) -> None:
        try:
            cell = self._work.get(timeout=INTERVAL)
        except queue.Empty:
            cell = _CHANGED
        try:
            self._reports.reach("" if peers.reached else "the connection is lost")
            if cell == _CHANGED:
                self._forget_silent()
                peers.announce(self._own_checksum())
            else:
                with self._lock:
                    checksum = self._announced.pop(cell)
                self._follow(peers, cell, checksum)
        except BusError as error:
            self._reports.reach(str(error))
        except PalpateError as error:  # of the store: another process has it locked, or the disk is full
            self._reports.trouble(str(error))

    def _forget_silent(self) -> None:
        with self._lock:
            for cell in [name for name, peer in self._peers.items() if peer.since.seconds > _REMEMBERED]:
                del self._peers[cell]

    def _own_checksum(self) -> str:
        revision = self._store.revision()
        with self._lock:
            if revision == self._revision:
                return self._checksum
        checksum = _checksum_of(self._store.digest().text())
        with self._lock:
            self._checksum, self._revision = checksum, revision
        return checksum

    def _follow(self, peers: Peers, cell: str, checksum: str) -> None:
        """Take over what a cell has that has announced itself."""
        with self._settled:
            new = cell not in self._peers
            peer = self._peers.setdefault(cell, _Peer())
            peer.checksum, peer.since = checksum, Stopwatch()
            self._settled.notify_all()
        if new:  # it has not heard of us either
            peers.announce(self._own_checksum())
        if checksum in (peer.taken, self._own_checksum()):
            return
        before = self._own_checksum()
        if self._take_over(peers, cell):
            peer.taken = checksum
        if self._own_checksum() != before:
            peers.announce(self._own_checksum())

    def _take_over(self, peers: Peers, cell: str) -> bool:
        """Ask one cell until it has nothing new; False if it did not answer."""
        while not self._closing.is_set():
            question = f"{self._cell}\n{self._store.digest().text()}".encode()
            answer = peers.ask(cell, question, ANSWER_TIMEOUT)
            if answer is None:
                return False
            merge = self._store.add(self._evidence_in(answer))
            self._reports.merged(cell, merge.added, merge.turned, merge.conflicts)
            if not merge.added and not merge.turned:
                return True
        return False

    def _evidence_in(self, answer: bytes) -> list[Evidence]:
        found = {}
        for line in answer[:_LONGEST].splitlines():
            try:
                item = evidence_from(line, "an answer")
            except InputError as error:
                self.misheard(str(error))
            else:
                found[item.identity] = item
        return list(found.values())

    def _all_given(self) -> bool:
        """Whether every cell that is there has been given all that is known here."""
        try:
            announced = self._store.revision() == self._revision
        except PalpateError:  # of a store that fails there is nothing to wait for
            return True
        present = [peer for peer in self._peers.values() if peer.checksum and peer.since.seconds < _PRESENT]
        return announced and all(self._checksum in (peer.checksum, peer.given) for peer in present)


_CHECKSUM = 32  # letters


def _checksum_of(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:_CHECKSUM]


class _Reports:
    """What there is to say about an exchange, each kind at a limited rate and summed up since the last time."""

    def __init__(self, where: str) -> None:
        self._where = where
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._texts: dict[str, str] = {}
        self._cells: set[str] = set()
        self._away: str | None = None  # why the others cannot be reached; None: not known yet
        self._said_away: str | None = None
        self._last: dict[str, Stopwatch] = {}

    def merged(self, cell: str, added: int, turned: int, conflicts: tuple[Evidence, ...]) -> None:
        with self._lock:
            self._counts["added"] += added
            self._counts["turned"] += turned
            if added or turned:
                self._cells.add(cell)
            if conflicts:
                first = conflicts[0]
                self._counts["conflicts"] += len(conflicts)
                self._texts["conflicts"] = f"search {first.search} of session {first.session}, from {cell}"

    def drop(self, what: str) -> None:
        with self._lock:
            self._counts["dropped"] += 1
            self._texts["dropped"] = what

    def trouble(self, what: str) -> None:
        with self._lock:
            self._counts["trouble"] += 1
            self._texts["trouble"] = what

    def reach(self, why_not: str) -> None:
        """The others are reached, or why they are not."""
        with self._lock:
            self._away = why_not

    def due(self, last: bool) -> list[tuple[str, int]]:
        with self._lock:
            said = []
            if self._turned_away() and self._may_say("away", last):
                self._said_away = self._away
                if self._away:
                    text = f"shares no evidence with other cells until {self._where} answers: {self._away}"
                    said.append((text, logging.WARNING))
                else:
                    said.append((f"shares evidence with other cells through {self._where}", logging.INFO))
            if self._counts["added"] + self._counts["turned"] and self._may_say("merged", last):
                said.append((self._merged_text(), logging.INFO))
            said += [
                (text, logging.WARNING)
                for kind, lead in (
                    ("conflicts", "searches left out, held here with other content under the same name"),
                    ("dropped", "messages of other cells dropped, which this palpate cannot read"),
                    ("trouble", "times the store could not take over evidence"),
                )
                if self._counts[kind] and self._may_say(kind, last)
                for text in (f"{self._counts.pop(kind)} {lead}; the last: {self._texts.pop(kind)}",)
            ]
            return said

    def _turned_away(self) -> bool:
        now, said = self._away, self._said_away
        return now is not None and (said is None or bool(now) != bool(said))

    def _merged_text(self) -> str:
        added, turned = self._counts.pop("added", 0), self._counts.pop("turned", 0)
        cells = f"{len(self._cells)} cells" if len(self._cells) > 1 else next(iter(self._cells))
        self._cells.clear()
        words = [f"searches taken over: {added}"] * bool(added) + [f"forgotten or recalled: {turned}"] * bool(turned)
        return f"{', '.join(words)} from {cells}"

    def _may_say(self, kind: str, last: bool) -> bool:
        if not last and kind in self._last and self._last[kind].seconds < _QUIET:
            return False
        self._last[kind] = Stopwatch()
        return True
