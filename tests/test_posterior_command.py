"""palpate posterior: what was learnt, shown, taken elsewhere and forgotten; every mistake answered in one line."""

from __future__ import annotations

import csv
import io
import json
import os
import pty
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from search_samples import REAL, found, tries

from runtime.belief import belief_about
from runtime.cli import main
from runtime.evidence.store import PosteriorStore
from runtime.messages import Ending

STORE = Path("logs/posterior.sqlite3")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    with PosteriorStore(STORE) as store:
        for search in range(1, 9):
            hole = f"h{1 + search % 3}"
            lost = search == 4
            result = found(search, hole, x=1e-4 * search, ending=Ending.EXHAUSTED if lost else Ending.INSERTED)
            attempts = tries(search, hole)[: 1 if lost else 2]
            store.record(
                "driver", result, f"session-{search // 5}", attempts, scope=REAL if search < 7 else "sim-seed-7"
            )
        store.record("psu", replace(found(1), component="capacitor"), "session-2", tries(1), scope=REAL)
    return tmp_path


class Palpate:
    """Runs a command and keeps what it said."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: str, code: int = 0) -> str:
        self._capsys.readouterr()
        done = main(["posterior", *arguments])
        out, err = self._capsys.readouterr()
        assert done == code, (out, err)
        if code == 0:
            assert err == ""
            return out
        assert out == ""
        assert err.startswith("palpate: ")
        assert err.count("\n") == 1
        return err


@pytest.fixture
def palpate(capsys: pytest.CaptureFixture[str]) -> Palpate:
    return Palpate(capsys)


def row(shown: str, *start: str) -> list[str]:
    (line,) = [line.split() for line in shown.splitlines() if line.split()[: len(start)] == list(start)]
    return line[len(start) :]


def test_list_counts_what_there_is(palpate: Palpate) -> None:
    shown = palpate("list")
    numbers = row(shown, "driver", "igbt", REAL)
    assert numbers[:5] == ["6", "5", "1", "0", "2"]  # searches, inserted, exhausted, aborted, sessions
    assert numbers[7] == "0"
    assert row(shown, "driver", "igbt", "sim-seed-7")[:2] == ["2", "2"]
    assert row(shown, "psu", "capacitor", REAL)[0] == "1"
    assert f"{STORE}: " in shown


def test_show_says_what_the_evidence_says(palpate: Palpate, folder: Path) -> None:
    shown = palpate("show", "driver", "--scope", REAL, "--prior-width", "0.25")
    with PosteriorStore(STORE) as store:
        seats = store.seats("driver", "igbt", scope=REAL)
    for hole, blocked in (("h1", 2), ("h2", 2), ("h3", 2)):
        belief, _ = belief_about(hole, seats, 0.25e-3)
        inserted = sum(seat.hole == hole for seat in seats)
        numbers = [belief.x, belief.y, belief.xx**0.5, belief.yy**0.5]
        assert row(shown, hole) == [str(inserted), str(blocked), *(f"{number * 1e3:.3f}" for number in numbers)]
    one = palpate("show", "driver", "--scope", REAL, "--prior-width", "0.25", "--hole", "h2", "--picture", "h.png")
    assert row(one, "h2") == row(shown, "h2")
    assert "h1" not in one
    assert (folder / "h.png").read_bytes().startswith(b"\x89PNG")
    assert "sim-seed-7" in palpate("show", "driver")


@pytest.mark.parametrize("name", ["holes.json", "holes.jsonl"])
def test_what_is_exported_can_be_imported_once(palpate: Palpate, name: str) -> None:
    assert "9 searches" in palpate("export", name)
    assert "9 searches new in other/new.sqlite3, 0 known" in palpate("import", name, "--store", "other/new.sqlite3")
    assert "0 searches new in other/new.sqlite3, 9 known" in palpate("import", name, "--store", "other/new.sqlite3")
    with PosteriorStore(STORE) as store, PosteriorStore("other/new.sqlite3") as other:
        assert other.evidence() == store.evidence()
    for arguments in (["show", "driver"], ["export"]):
        assert palpate(*arguments, "--store", "other/new.sqlite3") == palpate(*arguments)


def test_export_of_a_part_as_lines_and_as_a_table(palpate: Palpate, folder: Path) -> None:
    lines = [json.loads(line) for line in palpate("export", "--board-type", "driver", "--scope", REAL).splitlines()]
    assert [line["search"] for line in lines] == [1, 2, 3, 4, 5, 6]
    palpate("export", "attempts.csv", "--board-type", "driver", "--scope", REAL)
    rows = list(csv.DictReader(io.StringIO((folder / "attempts.csv").read_text())))
    assert [(item["search"], item["attempt"], item["outcome"]) for item in rows][5:8] == [
        ("3", "2", "seated"),
        ("4", "1", "blocked"),
        ("5", "1", "blocked"),
    ]
    assert float(rows[0]["x_m"]) == 1e-4


def test_forget_asks_and_a_copy_does_not_bring_it_back(palpate: Palpate, monkeypatch: pytest.MonkeyPatch) -> None:
    palpate("export", "holes.json")
    with Path(os.devnull).open() as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        assert "forget 8 searches of driver in logs/posterior.sqlite3? Confirm with --yes" in palpate(
            "forget", "driver", code=2
        )
    assert "2 searches forgotten" in palpate("forget", "driver", "--scope", "sim-seed-7", "--yes")
    assert "6 searches forgotten" in palpate("forget", "driver", "--yes")
    assert row(palpate("list"), "driver", "igbt", REAL)[0] == "0"
    assert "known: psu" in palpate("show", "driver", code=2)
    assert "8 of them forgotten" in palpate("import", "holes.json")
    assert len(palpate("export").splitlines()) == 1
    everything = palpate("export", "--forgotten")
    assert len(everything.splitlines()) == 9
    Path("all.jsonl").write_text(everything)
    palpate("import", "holes.json", "--store", "other.sqlite3")
    palpate("import", "all.jsonl", "--store", "other.sqlite3")  # forgetting travels, too
    assert len(palpate("export", "--store", "other.sqlite3").splitlines()) == 1
    assert "8 searches recalled" in palpate("forget", "driver", "--undo")
    assert row(palpate("list"), "driver", "igbt", REAL)[0] == "6"


@pytest.mark.parametrize(("answer", "left"), [("y\n", 1), ("n\n", 9), ("\n", 9)])
def test_forget_heeds_the_answer_on_a_terminal(monkeypatch: pytest.MonkeyPatch, answer: str, left: int) -> None:
    ours, theirs = pty.openpty()
    os.write(ours, answer.encode())
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        assert main(["posterior", "forget", "driver"]) == (0 if left == 1 else 2)
    os.close(ours)
    with PosteriorStore(STORE) as store:
        assert len(store.evidence()) == left


GOOD = (
    '{"scope":"real","session":"s","search":1,"recorded_at":5,"board_type":"driver","component":"igbt","board":1,'
    '"hole":"h1","ending":"exhausted","x":null,"y":null,"seated_x":null,"seated_y":null,"slid":false,'
    '"tried":[{"number":1,"x":0.0,"y":0.0,"outcome":"blocked"}]}'
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "holds no evidence"),
        ("hello", "line 1: Invalid JSON"),
        ("[1", "line 1: Expecting ',' delimiter"),
        ("[" * 100_000, "nested too deep"),
        ('["a"]', "entry 1: should be a JSON object"),
        (
            f"{GOOD}\n\n{GOOD.replace('blocked', 'lucky')}",
            "line 3: tried.0.outcome: should be seated, blocked, aborted",
        ),
        (f"[{GOOD},{GOOD.replace(':1,', ':0,', 1)}]", "entry 2: search: should be greater than or equal to 1 (got 0)"),
        (GOOD.replace('"board":1', '"board":"1"'), "line 1: board: should be a valid integer (got '1')"),
        (GOOD.replace('"hole"', '"whole"'), "line 1: hole: is missing"),
        (GOOD.replace('"slid"', '"colour":"red","slid"'), "line 1: colour: unknown field"),
        (GOOD.replace('"x":0.0', '"x":1e999'), "line 1: "),
        (GOOD.replace(":5,", ":9000000000000000000,"), "line 1: recorded_at: should be less"),
        (f"{GOOD}\n{GOOD.replace('h1', 'h2')}", "line 2: search 1 of session s stands in line 1 with other content"),
    ],
    ids=lambda text: text[-30:],
)
def test_nothing_of_a_wrong_file_is_imported(palpate: Palpate, text: str, said: str) -> None:
    Path("wrong.json").write_text(text)
    assert f"wrong.json: {said}" in palpate("import", "wrong.json", code=2)
    assert "9 searches to a.json" in palpate("export", "a.json")


def test_an_import_that_contradicts_the_store_is_refused_whole(palpate: Palpate) -> None:
    exported = palpate("export").splitlines()
    Path("wrong.jsonl").write_text("\n".join([GOOD, exported[0].replace('"h2"', '"h3"')]))
    assert "search 1 of session session-0 (real) is in posterior.sqlite3 with other content" in palpate(
        "import", "wrong.jsonl", code=2
    )
    assert palpate("export").splitlines() == exported


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["show", "drive"], "no evidence about board type 'drive'; did you mean 'driver'?"),
        (["show", "driver", "--component", "diode"], "known: igbt"),
        (["show", "driver", "--scope", "sim"], "known: real, sim-seed-7"),
        (["show", "driver", "--hole", "h9"], "known: h1, h2, h3"),
        (["show", "driver", "--prior-width", "0"], "--prior-width 0"),
        (["show", "driver", "--picture", "h.txt"], "--picture should end in .png, .svg"),
        (["export", "holes.txt"], "should end in .json, .jsonl, .csv"),
        (["export", "nowhere/holes.json"], "nowhere is no folder"),
        (["export", "--board-type", "drive"], "did you mean 'driver'?"),
        (["import", "nothing.json"], "nothing.json cannot be read"),
        (["import", "attempts.csv"], "cannot be imported"),
        (["import", str(STORE)], "is no text"),
        (["forget"], "name one board type, or --all"),
        (["forget", "driver", "--all"], "name one board type, or --all"),
        (["forget", "drive", "--yes"], "did you mean 'driver'?"),
        (["forget", "driver", "--store", "none.sqlite3"], "no posterior store none.sqlite3"),
        (["list", "--logs", "elsewhere"], "no posterior store elsewhere/posterior.sqlite3"),
        (["list", "--store", "logs/other.sqlite3"], "in logs/ there is posterior.sqlite3"),
        ([], "ACTION"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_mistakes_are_answered_in_one_line(palpate: Palpate, folder: Path, arguments: list[str], said: str) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert said in palpate(*arguments, code=2)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_damaged_store_is_told_and_left_alone(palpate: Palpate) -> None:
    content = b"\xff" * 4096 + STORE.read_bytes()[4096:]
    STORE.write_bytes(content)
    for action in (["list"], ["show", "driver"], ["export"], ["forget", "driver", "--yes"]):
        assert "posterior.sqlite3: damaged" in palpate(*action, code=1)
    assert STORE.read_bytes() == content
    assert [path.name for path in STORE.parent.iterdir()] == [STORE.name]


@pytest.mark.parametrize("action", ["", "list", "show", "export", "import", "forget"])
def test_each_action_explains_itself_with_an_example(capsys: pytest.CaptureFixture[str], action: str) -> None:
    assert main([*f"posterior {action}".split(), "--help"]) == 0
    assert f"palpate posterior {action}" in capsys.readouterr().out.split("examples:")[1]
