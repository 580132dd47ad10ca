"""The statistical model against the full physics, and its constants by least squares."""

import math
from dataclasses import replace

import numpy as np
import pytest

from runtime.experiment.calibrate import STUDY
from runtime.experiment.contenders import contender
from runtime.experiment.fit import fit_capture, fit_timing
from runtime.experiment.model import Capture, Timing
from runtime.experiment.paired import Pair, PairedTrial, Twin
from runtime.experiment.trial import Trial
from runtime.experiment.worlds import world
from runtime.plugin import SearchRecord


@pytest.fixture(scope="module")
def pair() -> Pair:
    """One board in both."""
    return PairedTrial(Trial(world("located"), "capacitor", contender("bayes-slide"), 3, 1)).run()


def test_one_board_goes_the_same_way_in_both(pair: Pair) -> None:
    equal = [twin.seated == twin.model_seated for twin in pair.twins]
    assert np.mean(equal) >= 0.9
    assert len(pair.physics) == len(pair.model) == 9
    assert sum(search.attempts for search in pair.physics) == len(pair.twins)
    assert [(a.board, a.hole) for a in pair.physics] == [(b.board, b.hole) for b in pair.model]
    for twin in pair.twins:
        assert not twin.aborted
        if not twin.slide and abs(twin.margin) > 10e-6:
            assert twin.model_seated == (twin.margin > 0)


def test_findings_of_one_board(pair: Pair) -> None:
    chosen = replace(
        STUDY.defaults, seeds=1, boards=1, worlds=("located",), components=("capacitor",), strategies=("bayes-slide",)
    )
    (work,) = STUDY.work(chosen)
    findings = STUDY.findings(chosen, {work: pair})
    attempts, searches, constants = findings.tables
    assert attempts.rows[0][3] == len(pair.twins)
    assert searches.rows[0][:3] == ("located", "capacitor", "bayes-slide")
    assert {row[0] for row in constants.rows} == (vars(Timing()) | vars(Capture())).keys() - {"step"}
    assert "same outcome" in findings.verdict[0]
    from matplotlib.figure import Figure

    figure = Figure()
    findings.figures[0].draw(figure)
    assert len(figure.axes) == 2


def made_up(timing: Timing, capture: Capture, seed: int) -> Pair:
    """A run of searches in which exactly these constants hold: pecks, and slides after a blocked one."""
    draw = np.random.default_rng(seed)
    twins, searches = [], []
    for search in range(1, 61):
        spent = 0.0
        for number in range(1, 7):
            seated, slide = number == 6, search % 2 == 0
            moved = 0.0 if number == 1 else float(draw.uniform(0.2e-3, 2e-3))
            slid = float(draw.uniform(1e-3, 20e-3)) if slide else 0.0
            exact = timing.attempt(moved=moved, seated=seated, slid=slid if slide else None)
            kept = capture.slide_kept if slide else capture.peck_kept
            noise = capture.slide_noise if slide else capture.peck_noise
            off = draw.normal(0.0, 0.15e-3, 2)
            seat = kept * off + noise * draw.standard_normal(2) if seated else np.full(2, math.nan)
            nearest = float(draw.uniform(0.0, capture.swath) if seated else draw.uniform(capture.swath, 2.0))
            twins.append(
                Twin(
                    search=search,
                    number=number,
                    slide=slide,
                    seated=seated,
                    model_seated=seated,
                    aborted=False,
                    margin=-0.1e-3 if slide or not seated else 0.1e-3,
                    nearest=nearest if slide else 0.0,
                    off=(float(off[0]), float(off[1])),
                    seat_off=(float(seat[0]), float(seat[1])),
                    moved=moved,
                    slid=slid,
                    duration=exact + float(draw.normal(0.0, 2e-3)),
                    model_duration=exact,
                )
            )
            spent += exact
        searches.append(SearchRecord(1, "1", True, 6, spent, spent + timing.part, 0.0, (0.0, 0.0)))
    return Pair(tuple(searches), tuple(searches), tuple(twins))


def test_the_fit_finds_the_constants_that_a_run_was_made_with() -> None:
    timing = Timing(6.4, 0.41, 0.95, 0.037, 0.6, 1.1, 4.6e-3)
    capture = Capture(swath=0.9, peck_kept=0.8, peck_noise=0.02e-3, slide_kept=0.5, slide_noise=0.05e-3)
    pairs = [made_up(timing, capture, seed) for seed in range(6)]
    times = fit_timing(pairs)
    for name, true in vars(timing).items():
        assert times[name].data > 0
        assert times[name].value == pytest.approx(true, rel=0.02), name
        assert abs(times[name].value - true) < 5 * times[name].error + 2e-3 * true, name
    for name, fitted in fit_capture(pairs).items():
        assert fitted.value == pytest.approx(getattr(capture, name), rel=0.15), name


def test_what_nothing_tells_is_kept() -> None:
    nothing = Pair((), (), ())
    assert {name: fitted.value for name, fitted in fit_timing([nothing]).items()} == vars(Timing())
    for name, fitted in fit_capture([nothing]).items():
        assert (fitted.value, fitted.data) == (getattr(Capture(), name), 0)
