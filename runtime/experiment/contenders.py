"""Who takes part in an experiment: strategies with their settings, under the names that tables use."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from runtime import registry
from runtime.errors import InputError, alternatives
from runtime.plugin import Strategy


@dataclass(frozen=True)
class Contender:
    """One strategy with its settings, as a cell file would write them."""

    name: str
    strategy: str
    settings: dict[str, Any] = field(default_factory=dict, hash=False)
    description: str = ""
    prior: bool = False  # whether it starts from the posterior store's belief, which takes time to compute

    def make(self) -> Strategy:
        """The strategy. Raises PluginError if none of that name is installed, CellError for a wrong setting."""
        return registry.strategy(self.strategy, self.settings, self.name)


_CONTENDERS = (
    Contender("linear", "linear", description="the paper's line"),
    Contender("spiral-nominal", "spiral", {"start": "nominal"}, "even spiral about nominal: learns nothing"),
    Contender("spiral", "spiral", description="even spiral about the mean of the hole's seats: the tuned spiral"),
    Contender("hybrid", "hybrid", description="line and spiral by turns"),
    Contender("meta", "meta", description="the paper's meta search, hole by hole"),
    Contender("meta-pooled", "meta", {"start": "pooled"}, "the paper's meta search, all holes together"),
    Contender("meta-posterior", "meta", {"start": "posterior"}, "meta from the store's belief", prior=True),
    Contender("bayes", "bayes", description="hierarchical belief, pecks"),
    Contender("bayes-slide", "bayes-slide", description="hierarchical belief, pecks and slides"),
)
CONTENDERS = {contender.name: contender for contender in _CONTENDERS}


def contender(name: str) -> Contender:
    """A contender by name, or any installed strategy with its default settings. Raises InputError for neither."""
    if name in CONTENDERS:
        return CONTENDERS[name]
    if name in registry.names(registry.STRATEGIES):
        return Contender(name, name, prior=True)
    known = {*CONTENDERS, *registry.names(registry.STRATEGIES)}
    raise InputError(f"no strategy {name!r} to compare; {alternatives(name, known)}")
