"""The studies of `palpate experiment`, by name; loaded only when asked for."""

from __future__ import annotations

from importlib import import_module

from runtime.errors import InputError, alternatives
from runtime.experiment.study import Study

STUDIES: dict[str, str] = {
    "table1": "runtime.experiment.tables:TABLE1",
    "table2": "runtime.experiment.tables:TABLE2",
    "table3": "runtime.experiment.table3:STUDY",
    "anomaly": "runtime.experiment.anomaly:STUDY",
    "covers": "runtime.experiment.covers:STUDY",
    "match": "runtime.experiment.match:STUDY",
    "calibrate": "runtime.experiment.calibrate:STUDY",
    "compare": "runtime.experiment.compare:STUDY",
    "robustness": "runtime.experiment.robustness:STUDY",
}


def study(name: str) -> Study:
    """The study of that name. Raises InputError that names the ones there are."""
    if name not in STUDIES:
        raise InputError(f"no experiment {name!r}; {alternatives(name, STUDIES)}")
    module, _, attribute = STUDIES[name].partition(":")
    found: Study = getattr(import_module(module), attribute)
    return found
