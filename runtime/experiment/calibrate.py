"""The statistical model beside the full physics: how far both agree, and which constants would fit best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from runtime.experiment.contenders import contender
from runtime.experiment.estimates import Estimate, mean_over_seeds
from runtime.experiment.fit import Fitted, fit_capture, fit_timing
from runtime.experiment.model import Capture, Timing
from runtime.experiment.paired import Pair, PairedTrial, Twin
from runtime.experiment.palette import COLOURS
from runtime.experiment.study import Assumption, Choices, Findings, Picture, Results, Table, Value
from runtime.experiment.trial import Trial
from runtime.experiment.worlds import world
from runtime.plugin import SearchRecord

_UNITS = {"travel_speed": ("mm/s", 1e3), "slide_speed": ("mm/s", 1e3), "swath": ("", 1.0)}
_UNITS |= {"peck_kept": ("", 1.0), "slide_kept": ("", 1.0), "peck_noise": ("µm", 1e6), "slide_noise": ("µm", 1e6)}
_RIM = 40e-6  # [m] about the rim of the feasible area, that the figure shows

Group = tuple[str, str, str]  # world, component, strategy
Groups = dict[Group, list[Pair]]  # a pair for each seed


class Calibrate:
    """The same trials in both."""

    name = "calibrate"
    summary = "the statistical model of a cell against the full physics, attempt by attempt; constants that fit best"
    defaults = Choices(
        seeds=2,
        boards=4,
        strategies=("spiral", "bayes-slide"),
        worlds=("located", "realistic"),
        components=("igbt", "capacitor"),
    )

    def work(self, chosen: Choices) -> list[PairedTrial]:
        """Each trial in both."""
        return [paired for trials in self._paired(chosen).values() for paired in trials]

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """Agreement, constants, and what to make of them."""
        groups = {group: [results[paired] for paired in trials] for group, trials in self._paired(chosen).items()}
        pairs = [pair for group in groups.values() for pair in group]
        timing, capture = fit_timing(pairs), fit_capture(pairs)
        return Findings(
            tables=(_attempts(groups), _searches(groups), _constants(timing, capture)),
            figures=(
                Picture(
                    "agreement", "Where attempts went in, and how long pecks took: physics and model", _draw(pairs)
                ),
            ),
            verdict=_verdict(pairs, timing, capture),
            assumptions=(
                Assumption(
                    "when a part goes in",
                    "every pin's tip lies over its hole",
                    "geometry (`runtime.component.feasible`); the physics adds contact, friction and a yielding arm",
                ),
            ),
        )

    def _paired(self, chosen: Choices) -> dict[Group, list[PairedTrial]]:
        return {
            (place, component, strategy): [
                PairedTrial(Trial(world(place), component, contender(strategy), seed, chosen.boards))
                for seed in chosen.seed_numbers
            ]
            for place in chosen.worlds
            for component in chosen.components
            for strategy in chosen.strategies
        }


def _attempts(groups: Groups) -> Table:
    rows: list[tuple[Value, ...]] = []
    for group, pairs in groups.items():
        twins = [twin for pair in pairs for twin in pair.twins]
        wrong = [twin for twin in twins if _differs(twin)]
        off = max((abs(twin.margin) for twin in wrong if not twin.slide), default=None)
        rows.append(
            (
                *group,
                len(twins),
                sum(twin.slide for twin in twins),
                len(wrong),
                1.0 - len(wrong) / len(twins) if twins else None,
                None if off is None else 1e6 * off,
                sum(twin.aborted for twin in twins),
            )
        )
    return Table(
        "attempts",
        "The physics' attempts, each tried in the model too",
        (
            "world",
            "component",
            "strategy",
            "attempts",
            "of them slides",
            "other outcome",
            "share equal",
            "farthest such peck from the rim [µm]",
            "aborted",
        ),
        tuple(rows),
    )


def _searches(groups: Groups) -> Table:
    measures: dict[str, Callable[[SearchRecord], float]] = {
        "attempts": lambda search: search.attempts,
        "inserted": lambda search: search.seated,
        "s at the hole": lambda search: search.search_time,
        "s per part": lambda search: search.part_time,
    }
    rows: list[tuple[Value, ...]] = []
    for group, pairs in groups.items():
        equal = [[float(a.attempts == b.attempts and a.seated == b.seated) for a, b in _both(pair)] for pair in pairs]
        row: list[Value] = [*group, float(np.mean(np.concatenate(equal)))]
        for measure in measures.values():
            row += [_over_seeds(pairs, "physics", measure), _over_seeds(pairs, "model", measure)]
        rows.append(tuple(row))
    headings = [f"{what}, {where}" for what in measures for where in ("physics", "model")]
    return Table(
        "",
        "Whole searches; one attempt with another outcome changes all that follow on that seed",
        ("world", "component", "strategy", "share of equal searches", *headings),
        tuple(rows),
    )


def _constants(timing: dict[str, Fitted], capture: dict[str, Fitted]) -> Table:
    given = vars(Timing()) | vars(Capture())
    rows: list[tuple[Value, ...]] = []
    for name, fitted in (timing | capture).items():
        unit, scale = _UNITS.get(name, ("s", 1.0))
        measured = Estimate(scale * fitted.value, scale * fitted.error) if fitted.data else None
        rows.append((name, unit, scale * given[name], measured, fitted.data))
    return Table(
        "constants",
        "The model's constants, and those that fit this physics best; empty: too few attempts tell",
        ("constant", "unit", "in the model", "measured", "from so many"),
        tuple(rows),
    )


def _verdict(pairs: Sequence[Pair], timing: dict[str, Fitted], capture: dict[str, Fitted]) -> tuple[str, ...]:
    twins = [twin for pair in pairs for twin in pair.twins]
    lines = []
    for kind, some in (("pecks", [t for t in twins if not t.slide]), ("slides", [t for t in twins if t.slide])):
        wrong = [twin for twin in some if _differs(twin)]
        if some:
            lines.append(
                f"{len(some) - len(wrong)} of {len(some)} {kind} ({1 - len(wrong) / len(some):.2%}) "
                f"had the same outcome in the model as in the physics."
            )
    both = [search for pair in pairs for search in _both(pair)]
    for what, of, unit in (
        ("attempts for each search", lambda search: float(search.attempts), ""),
        ("seconds for each part", lambda search: search.part_time, " s"),
    ):
        real, model = (float(np.mean([of(pair[which]) for pair in both])) for which in (0, 1))
        lines.append(
            f"Mean {what}: {real:.2f}{unit} in the physics, {model:.2f}{unit} in the model ({model / real - 1:+.1%})."
        )
    lines.append(f"Best fit: Timing({_arguments(timing)}), Capture({_arguments(capture)}), in SI units.")
    return tuple(lines)


def _arguments(constants: dict[str, Fitted]) -> str:
    return ", ".join(f"{name}={fitted.value:.3g}" for name, fitted in constants.items() if fitted.data)


def _both(pair: Pair) -> list[tuple[SearchRecord, SearchRecord]]:
    return list(zip(pair.physics, pair.model, strict=True))


def _over_seeds(pairs: Sequence[Pair], which: str, measure: Callable[[SearchRecord], float]) -> Estimate:
    return mean_over_seeds([[float(measure(search)) for search in getattr(pair, which)] for pair in pairs])


def _differs(twin: Twin) -> bool:
    return twin.seated != twin.model_seated


def _draw(pairs: Sequence[Pair]) -> Callable[[Any], None]:
    pecks = [twin for pair in pairs for twin in pair.twins if not twin.slide and not twin.aborted]

    def draw(figure: Any) -> None:
        outcome, duration = figure.subplots(1, 2)
        for seated, label, colour in ((True, "went in", COLOURS[2]), (False, "blocked", COLOURS[1])):
            margins = [1e6 * t.margin for t in pecks if t.seated == seated and abs(t.margin) < _RIM]
            outcome.hist(margins, bins=np.linspace(-1e6 * _RIM, 1e6 * _RIM, 41), label=label, color=colour, alpha=0.8)
            some = [t for t in pecks if t.seated == seated]
            duration.plot([1e3 * t.moved for t in some], [t.duration for t in some], ".", color=colour, label=label)
            if some:
                moved = np.linspace(0.0, max(twin.moved for twin in some), 50)
                model = [Timing().attempt(moved=float(way), seated=seated) for way in moved]
                duration.plot(1e3 * moved, model, color="black", linewidth=1)
        outcome.axvline(0.0, color="black", linewidth=1)
        outcome.set(xlabel="within the feasible area's rim [µm]", ylabel="pecks in the physics")
        duration.set(xlabel="way from the attempt before [mm]", ylabel="duration of a peck [s]; lines: model")
        outcome.legend()
        duration.legend()

    return draw


STUDY = Calibrate()
