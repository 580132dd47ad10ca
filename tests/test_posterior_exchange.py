"""Stores that exchange evidence, by files or by messages, come to know the same, whatever happens on the way."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from search_samples import REAL, found, tries

from runtime.errors import InputError
from runtime.evidence.digest import Digest, Run, digest_from
from runtime.evidence.evidence import LATEST, Evidence, Tried, evidence_from, text_of
from runtime.evidence.store import PosteriorStore
from runtime.evidence.text import as_json, as_lines, read_text
from runtime.messages import Ending, Outcome

NAMES = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=8)
LENGTHS = st.floats(allow_nan=False, allow_infinity=False)
NUMBERS = st.integers(1, 2**32 - 1)
ATTEMPTS = st.builds(
    Tried,
    number=NUMBERS,
    x=st.none() | LENGTHS,
    y=st.none() | LENGTHS,
    outcome=st.sampled_from(Outcome),
    path=st.lists(st.tuples(LENGTHS, LENGTHS), max_size=3).map(tuple),
)
EVIDENCE = st.builds(
    Evidence,
    scope=NAMES,
    session=NAMES,
    search=NUMBERS,
    recorded_at=st.integers(0, LATEST),
    board_type=NAMES,
    component=NAMES,
    board=NUMBERS,
    hole=NAMES,
    ending=st.sampled_from(Ending),
    x=st.none() | LENGTHS,
    y=st.none() | LENGTHS,
    seated_x=st.none() | LENGTHS,
    seated_y=st.none() | LENGTHS,
    slid=st.booleans(),
    tried=st.lists(ATTEMPTS, max_size=3, unique_by=lambda tried: tried.number).map(
        lambda tried: tuple(sorted(tried, key=lambda item: item.number))
    ),
    life=st.integers(1, 5),
)


def in_memory() -> PosteriorStore:
    return PosteriorStore(":memory:")


@settings(max_examples=40, deadline=None)
@given(st.lists(EVIDENCE, max_size=4, unique_by=lambda item: item.identity))
def test_evidence_survives_text_and_store(evidence: list[Evidence]) -> None:
    assert [evidence_from(text_of(item), "here") for item in evidence] == evidence
    if evidence:
        assert read_text(as_json(evidence), "f") == read_text(as_lines(evidence), "f") == evidence
    with in_memory() as store:
        assert store.add(evidence).added == len(evidence)
        kept = store.evidence(forgotten=True)
        assert sorted(kept, key=lambda item: item.identity) == sorted(evidence, key=lambda item: item.identity)
        assert [item.checksum for item in kept] == [evidence_from(text_of(item), "").checksum for item in kept]
        assert [item.recorded_at for item in kept] == sorted(item.recorded_at for item in evidence)
        assert digest_from(store.digest().text()) == store.digest()
        assert store.lacking(store.digest()) == []
        assert store.lacking(Digest([])) == kept


class Cells(RuleBasedStateMachine):
    """Three cells that record, forget and recall, are cut off, catch up in parts, and hear some things twice."""

    @initialize()
    def begin(self) -> None:
        self.stores = [in_memory() for _ in range(3)]
        self.counts = [count(1) for _ in self.stores]
        self.recorded = 0
        self.sent: list[list[Evidence]] = []  # messages that may yet arrive, again

    cells = st.integers(0, 2)

    @rule(cell=cells, board_type=st.sampled_from(["driver", "psu"]))
    def record(self, cell: int, board_type: str) -> None:
        search = next(self.counts[cell])
        assert self.stores[cell].record(board_type, found(search), f"cell-{cell}", tries(search), scope=REAL)
        self.recorded += 1

    @rule(cell=cells, board_type=st.sampled_from(["driver", "psu"]))
    def forget(self, cell: int, board_type: str) -> None:
        store = self.stores[cell]
        assert store.forget(board_type) == len([1 for item in self.before(cell) if item.board_type == board_type])
        assert store.evidence(board_type) == []

    @rule(cell=cells, board_type=st.sampled_from(["driver", "psu"]))
    def recall(self, cell: int, board_type: str) -> None:
        self.stores[cell].recall(board_type)
        assert self.stores[cell].evidence(board_type) == self.stores[cell].evidence(board_type, forgotten=True)

    @rule(giver=cells, taker=cells, most=st.none() | st.integers(1, 3))
    def catch_up(self, giver: int, taker: int, most: int | None) -> None:
        digest = digest_from(self.stores[taker].digest().text())
        given = self.stores[giver].lacking(digest, most)
        assert most is None or len(given) <= most
        assert giver != taker or given == []
        self.sent.append(given)
        self.arrive(len(self.sent) - 1, taker)
        if most is None:
            assert self.stores[giver].lacking(self.stores[taker].digest()) == []

    @rule(number=st.integers(0, 1000), taker=cells)
    def arrive(self, number: int, taker: int) -> None:
        if self.sent:
            given = self.sent[number % len(self.sent)]
            merge = self.stores[taker].add([evidence_from(text_of(item), "here") for item in given])
            assert merge.added + merge.known == len(given)
            assert merge.conflicts == ()
            after = self.stores[taker].evidence(forgotten=True)
            again = self.stores[taker].add(given)
            assert (again.added, again.turned) == (0, 0)
            assert self.stores[taker].evidence(forgotten=True) == after

    def before(self, cell: int) -> list[Evidence]:
        return [item for item in self.last[cell] if not item.forgotten]

    @invariant()
    def remember(self) -> None:
        self.last = [store.evidence(forgotten=True) for store in self.stores]

    def teardown(self) -> None:
        for store in self.stores:
            for other in self.stores:
                store.add(other.lacking(store.digest()))
        for store in self.stores:
            for other in self.stores:
                store.add(other.lacking(store.digest()))
        first, *others = self.stores
        assert len(first.evidence(forgotten=True)) == self.recorded  # none lost, none twice
        for other in others:
            assert other.evidence(forgotten=True) == first.evidence(forgotten=True)
            for read in (PosteriorStore.seats, PosteriorStore.misses):  # their text, since nan is not nan
                assert repr(read(other, "driver", "igbt", scope=REAL)) == repr(
                    read(first, "driver", "igbt", scope=REAL)
                )
            assert other.digest().text() == first.digest().text()
        for store in self.stores:
            store.close()


def test_cells_that_catch_up_come_to_know_the_same() -> None:
    run_state_machine_as_test(Cells, settings=settings(max_examples=30, stateful_step_count=15, deadline=None))


def filled(path: str | Path, searches: int = 3) -> PosteriorStore:
    store = PosteriorStore(path)
    for search in range(1, searches + 1):
        store.record("driver", found(search), "monday", tries(search), scope=REAL)
    return store


def test_what_was_forgotten_does_not_come_back_unless_recalled() -> None:
    with filled(":memory:") as store, in_memory() as other:
        exported = store.evidence()
        other.add(exported)
        store.forget()
        merge = store.add([*exported, *other.lacking(store.digest())])
        assert (merge.added, merge.known, merge.turned, merge.forgotten) == (0, 3, 0, 3)
        assert store.evidence() == []
        merge = other.add(store.lacking(other.digest()))
        assert (merge.known, merge.turned) == (3, 3)
        assert other.seats("driver", "igbt", scope=REAL) == []
        assert other.recall() == 3
        store.add(other.lacking(store.digest()))
        assert [item.life for item in store.evidence()] == [3, 3, 3]


def test_other_content_under_a_taken_identity_is_reported_and_left_out() -> None:
    with filled(":memory:") as store:
        whole = store.evidence()
        other = replace(whole[1], hole="h9")
        new = replace(whole[1], session="tuesday")
        with pytest.raises(InputError, match=r"search 2 of session monday \(real\) is in :memory: with other content"):
            store.add([new, other], all_or_none=True)
        assert store.evidence() == whole
        merge = store.add([other, new])
        assert (merge.added, merge.conflicts) == (1, (other,))
        assert [item for item in store.evidence() if item.session == "monday"] == whole


def test_a_digest_is_a_run_for_each_stretch_of_searches() -> None:
    with filled(":memory:", 5) as store:
        assert store.digest().runs == (Run(REAL, "monday", 1, 5, 1),)
        store.add([replace(store.evidence()[0], search=9), replace(store.evidence()[2], life=2)])
        assert store.digest().runs == (
            Run(REAL, "monday", 1, 2, 1),
            Run(REAL, "monday", 3, 3, 2),
            Run(REAL, "monday", 4, 5, 1),
            Run(REAL, "monday", 9, 9, 1),
        )
    for wrong in ("", "{}", '[["real","monday",1]]', '[["real","monday",0,1,1]]', '[["real","monday",1,2,"1"]]'):
        with pytest.raises(InputError, match="no digest"):
            digest_from(wrong)
