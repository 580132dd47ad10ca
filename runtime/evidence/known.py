"""What a session goes by: the evidence of its store, as it was at its first question and after each of its searches.

Other processes add to a store and forget while a session runs: cells that share it, and people. What they change is
let in between two searches only and said in the log, so that a session can be decided again from its log alone.

Each board has a number of its own here: strategies tell boards by their number, and each session counts for itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from runtime.config import Cell
from runtime.evidence.evidence import Evidence, evidence_of, misses_of, seats_of
from runtime.evidence.store import PosteriorStore
from runtime.messages import Attempt, Merged, Miss, SearchResult, Seat, header


@dataclass
class KnownEvidence:
    """The evidence about the cell's boards in a store, as the session `session` has let it in."""

    store: PosteriorStore
    cell: Cell
    session: str  # unlike that of any other session of any cell
    _pieces: dict[tuple[str, int], Evidence] | None = None  # by session and search; None: nobody has asked yet
    _seats: list[Seat] = field(default_factory=list)
    _misses: list[Miss] = field(default_factory=list)
    _numbers: dict[tuple[str, int], int] = field(default_factory=dict)  # of other sessions' boards
    _own: int = 0  # highest number that a board of this session can have

    def seats(self) -> list[Seat]:
        """Every insertion, oldest first."""
        self._known()
        return self._seats

    def misses(self) -> list[Miss]:
        """Every attempt that was blocked, oldest first."""
        self._known()
        return self._misses

    def record(self, result: SearchResult, attempts: Sequence[Attempt]) -> bool:
        """Store how a search ended and all its attempts; False if its identity is taken, and nothing was stored."""
        cell, pieces = self.cell, self._known()
        board_type, scope = cell.board.type, cell.posterior.scope
        if not self.store.record(board_type, result, session=self.session, attempts=attempts, scope=scope):
            return False
        piece = evidence_of(board_type, result, self.session, attempts, scope=scope, recorded_at=0)
        pieces[piece.session, piece.search] = piece
        self._seats = [*self._seats, *seats_of(piece, piece.board)]
        self._misses = [*self._misses, *misses_of(piece, piece.board)]
        return True

    def merged(self, after: int, now: int) -> Merged | None:
        """Let in what others changed; what counts from now on, at session time `now` [ns] and after search `after`."""
        before = self._known()
        cell = self.cell
        if self.store.identities(cell.board.type, cell.component, scope=cell.posterior.scope) == before.keys():
            return None
        pieces = self._load()
        entered, withdrawn = len(pieces.keys() - before.keys()), len(before.keys() - pieces.keys())
        if not entered and not withdrawn:
            return None
        return Merged(header(now), after, entered, withdrawn, self._seats, self._misses)

    def _known(self) -> dict[tuple[str, int], Evidence]:
        if self._pieces is not None:
            return self._pieces
        pieces = self._load()
        boards = [seat.board for seat in self._seats] + [miss.board for miss in self._misses]
        self._own = max(boards, default=0) + self.cell.boards
        return pieces

    def _load(self) -> dict[tuple[str, int], Evidence]:
        cell = self.cell
        found = self.store.evidence(cell.board.type, cell.component, scope=cell.posterior.scope)
        numbers = [self._number(piece) for piece in found]
        self._seats = [seat for piece, number in zip(found, numbers, strict=True) for seat in seats_of(piece, number)]
        self._misses = [miss for piece, number in zip(found, numbers, strict=True) for miss in misses_of(piece, number)]
        self._pieces = {(piece.session, piece.search): piece for piece in found}
        return self._pieces

    def _number(self, piece: Evidence) -> int:
        """Its own if it can be had: unlike that of all other boards, those of this session included."""
        if piece.session == self.session:
            return piece.board
        key = (piece.session, piece.board)
        if key not in self._numbers:
            taken = set(self._numbers.values())
            free = self._pieces is None and piece.board not in taken
            self._numbers[key] = piece.board if free else 1 + max(taken | {self._own})
        return self._numbers[key]
