"""What a study is: it names the work it needs, and turns the results into tables, figures and a verdict in words.

A new study is one file with a class and one line in `studies.py`:

    class WidthStudy:
        '''How much a wrong prior width costs.'''

        name = "width"
        summary = "meta search with prior widths from 0.1 to 2 mm"
        defaults = Choices(seeds=50, boards=10, physics=False, worlds=("realistic",), components=("igbt",))

        def work(self, chosen: Choices) -> list[Trial]:
            return [trial for width in WIDTHS for trial in self._trials(chosen, width)]

        def findings(self, chosen: Choices, results: Results) -> Findings:
            rows = []
            for width in WIDTHS:
                by_seed = [[s.attempts for s in results[trial]] for trial in self._trials(chosen, width)]
                rows.append((width, mean_over_seeds(by_seed)))           # an Estimate is a cell too
            table = Table("", "Attempts by prior width", ("prior width, mm", "attempts"), tuple(rows))

            def draw(figure: Canvas) -> None:
                axes = figure.subplots()
                axes.errorbar(WIDTHS, [row[1].value for row in rows], [row[1].error for row in rows])
                axes.set(xlabel="prior width [mm]", ylabel="attempts per insertion")

            return Findings(
                tables=(table,),
                figures=(Picture("width", "Attempts by prior width", draw),),
                verdict=(aim("at 1 mm, meta's attempts", rows[2][1], at_most=20.0),),
                assumptions=(Assumption("nominal is off by", "0.5 mm", "a point taught by eye"),),
            )

        def _trials(self, chosen: Choices, width: float) -> list[Trial]:
            contender = Contender(f"meta {width} mm", "meta", {"prior_width": f"{width} mm"})
            return trials(chosen, world(chosen.worlds[0]), chosen.components[0], contender)

    STUDY = WidthStudy()

and in `studies.py`:  "width": "runtime.experiment.width:STUDY",

The work runs in parallel, is cached by content and may stop and go on; `findings` runs once, on all of it. A trial that
is asked for twice, or by two studies, runs once. Anything else that takes long is a piece of work too: a frozen
dataclass as `Work` describes. A study without work, such as one that only draws, returns an empty list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from runtime.experiment.estimates import Estimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Value = str | int | float | bool | Estimate | None
"""What a table has in a cell. Floats are rounded where people read and exact in CSV; an Estimate is `value ± error`,
in CSV two columns, `x` and `x_se`; None is an empty cell."""

Result = TypeVar("Result")
Result_co = TypeVar("Result_co", covariant=True)


class Work(Protocol[Result_co]):
    """A piece of work: a frozen dataclass that pickles. Equal content, equal result, on any machine."""

    @property
    def content(self) -> Mapping[str, Any]:
        """All that the result depends on, beside the code, as values and dataclasses that JSON can hold."""
        ...

    @property
    def code(self) -> tuple[str, ...]:
        """Names of the modules whose code makes the result; what they import is followed."""
        ...

    def run(self) -> Result_co:
        """Do it. Its return annotation says how the result is stored: dataclasses, tuples, numbers and text."""
        ...


class Results(Protocol):
    """What came out of a study's work."""

    def __getitem__(self, work: Work[Result]) -> Result:
        """The result of one piece; of a Trial its tuple of SearchRecords. KeyError if the study did not ask for it."""
        ...


@dataclass(frozen=True)
class Choices:
    """What a run is about. In a study's `defaults`, what is left empty (0, (), None) is no option of the study's.

    The command line refuses an option that the study does not offer, checks all names, and fills in what was not said.
    """

    seeds: int = 0  # how many; with --physics a tenth of the default unless said
    boards: int = 0
    physics: bool | None = None  # full physics instead of the statistical model
    strategies: tuple[str, ...] = ()  # names of contenders
    worlds: tuple[str, ...] = ()
    components: tuple[str, ...] = ()

    @property
    def seed_numbers(self) -> range:
        """The seeds themselves, from 1."""
        return range(1, self.seeds + 1)

    @property
    def offered(self) -> tuple[str, ...]:
        """Of a study's defaults: which of them are options."""
        return tuple(name for name, value in vars(self).items() if value is False or value not in (0, (), None))


@dataclass(frozen=True)
class Table:
    """Rows under headings; becomes text, Markdown and a CSV file."""

    key: str  # "" writes NAME.csv, anything else NAME-key.csv
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Value, ...], ...]
    shown: bool = True  # on the terminal and in NAME.md; otherwise in its CSV only


@dataclass(frozen=True)
class Picture:
    """A figure, drawn when it is written: NAME-key.png and NAME-key.svg."""

    key: str
    caption: str
    draw: Callable[[Canvas], None]  # on an empty matplotlib figure with constrained layout; style and colours are set
    size: tuple[float, float] = (8.0, 5.0)  # [inch]


@dataclass(frozen=True)
class Assumption:
    """A parameter that the paper leaves out."""

    what: str
    value: str  # with its unit
    why: str  # how it was matched or chosen


@dataclass(frozen=True)
class Findings:
    """What a study found."""

    tables: tuple[Table, ...]
    figures: tuple[Picture, ...] = ()
    verdict: tuple[str, ...] = ()  # one sentence each: reproduced, not reproduced, cannot be decided; aims met or not
    assumptions: tuple[Assumption, ...] = ()


class Study(Protocol):
    """One experiment of `palpate experiment`."""

    name: str
    summary: str  # one line, for the list
    defaults: Choices

    def work(self, chosen: Choices) -> Sequence[Work[Any]]:
        """Every piece of work that the findings need: Trials, mostly."""
        ...

    def findings(self, chosen: Choices, results: Results) -> Findings:
        """Tables, figures and verdict from the results."""
        ...


def aim(what: str, measured: Estimate, at_most: float, unit: str = "") -> str:
    """A verdict's sentence: what was measured, what was aimed at, whether it holds.

    "cannot be decided" where the aim lies within two standard errors of what was measured.
    """
    space = f" {unit}" if unit else ""
    decided = abs(measured.value - at_most) > 2 * measured.error
    if not decided:
        outcome = "cannot be decided with so few seeds"
    else:
        outcome = "holds" if measured.value <= at_most else "does not hold"
    return f"{what}: {measured}{space}; aim at most {at_most:g}{space}: {outcome}."


def listed(names: Iterable[str]) -> str:
    """Names as a sentence has them: a, b and c."""
    first = list(names)
    return " and ".join(part for part in (", ".join(first[:-1]), first[-1] if first else "") if part)
