"""Runs the work of a study: what the cache has not, in parallel, each result kept as soon as it is there."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from runtime.errors import SessionError
from runtime.experiment.cache import Cache, key_of
from runtime.experiment.executor import LOCAL, executor
from runtime.experiment.study import Result, Work

ROUND = 64  # pieces that an executor is given at a time if it hands over no single results


@dataclass(frozen=True)
class Progress:
    """How far a sweep is."""

    done: int
    total: int  # pieces of different content
    cached: int  # of those done, without doing anything


@dataclass(frozen=True)
class Swept:
    """Results by content."""

    by_key: dict[str, Any]
    cached: int  # that were there before

    @property
    def total(self) -> int:
        """How many there are, of different content."""
        return len(self.by_key)

    def __getitem__(self, work: Work[Result]) -> Result:
        """The result of one piece of work. KeyError if it was not asked for."""
        result: Result = self.by_key[key_of(work)]
        return result


def sweep(
    work: Sequence[Work[Any]],
    cache: Cache,
    *,
    jobs: int = -1,
    where: str = LOCAL,
    report: Callable[[Progress], None] = lambda _progress: None,
) -> Swept:
    """Do all of the work, or take it from the cache. `jobs` processes at once; -1: as many as there are cores.

    Interrupted in any way, it goes on where it was when called again.
    """
    cache.prepare()
    wanted = {key_of(piece): piece for piece in work}
    found: dict[str, Any] = {}
    for key, piece in wanted.items():
        result = cache.load(piece, key)
        if result is not None:
            found[key] = result
    cached = len(found)
    report(Progress(cached, len(wanted), cached))
    missing = [(key, piece) for key, piece in wanted.items() if key not in found]
    with closing(_run(missing, jobs, where)) as arriving:  # an interrupt anywhere ends the workers
        for key, result in arriving:
            cache.store(wanted[key], key, result)
            found[key] = result
            report(Progress(len(found), len(wanted), cached))
    return Swept(found, cached)


def _run(missing: list[tuple[str, Work[Any]]], jobs: int, where: str) -> Generator[tuple[str, Any], None, None]:
    if not missing:
        return
    from joblib import Parallel, delayed

    calls = [delayed(_do)(key, piece) for key, piece in missing]
    with executor(where) as streams, warnings.catch_warnings():
        # Whoever stops a sweep knows that some of it was not done.
        warnings.filterwarnings("ignore", r"\d+ tasks (have been successfully|which were still)", UserWarning)
        if streams:
            yield from Parallel(n_jobs=jobs, return_as="generator_unordered", max_nbytes=None)(calls)
            return
        for begin in range(0, len(calls), ROUND):
            yield from Parallel(n_jobs=jobs)(calls[begin : begin + ROUND])


def _do(key: str, piece: Work[Any]) -> tuple[str, Any]:
    """One piece, on whatever machine; refuses to answer with other code than was asked for."""
    if key_of(piece) != key:
        raise SessionError(
            "a worker has another version of palpate or of its packages, or files changed meanwhile; "
            "install the same everywhere"
        )
    return key, piece.run()
