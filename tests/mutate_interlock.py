"""Mutation testing of the safety state machine alone: what in it could be wrong without a test seeing it?

    pip install mutmut && python tests/mutate_interlock.py           # five minutes on two cores
    python tests/mutate_interlock.py '*Channel*'                     # only mutants whose name matches

Changes `runtime/safety/interlock.py` and `runtime/safety/muting.py` in a copy, one spot at a time, and runs
`tests/test_interlock.py` against each. Prints what survives; `tests/interlock_mutants.md` explains why that is no hole.
mutmut leaves properties alone, so the copy has them as methods behind properties.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

ROOT = Path(__file__).parent.parent
MUTATED = ("runtime/safety/interlock.py", "runtime/safety/muting.py")
NEEDED = ("runtime/__init__.py", "runtime/declaration.py", "runtime/messages", "runtime/safety/__init__.py")
TEST = "tests/test_interlock.py"
CONFIG = f"""[mutmut]
source_paths=runtime
only_mutate=
    {MUTATED[0]}
    {MUTATED[1]}
pytest_add_cli_args_test_selection={TEST}
also_copy=
    runtime
"""
_PROPERTY = re.compile(r"    @property\n    def (\w+)\(")


def without_properties(source: str) -> str:
    """The same module with each property as a method `value_of_NAME` and a property that calls it."""
    names = _PROPERTY.findall(source)
    source = _PROPERTY.sub(r"    def value_of_\1(", source)
    for name in names:
        source = re.sub(
            rf"(    def value_of_{name}\(.*?\n)(?=\n    (?:def|@)|\n\n)",
            rf"\1\n    {name} = property(lambda self: self.value_of_{name}())\n",
            source,
            count=1,
            flags=re.S,
        )
    return source


def prepare(folder: Path) -> None:
    """Copy what is mutated and what that needs."""
    for name in NEEDED:
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, target)
    for name in MUTATED:
        (folder / name).write_text(without_properties((ROOT / name).read_text()))
    (folder / "tests").mkdir()
    shutil.copy(ROOT / TEST, folder / TEST)
    (folder / "setup.cfg").write_text(CONFIG)


def mutmut(folder: Path, *arguments: str) -> str:
    """Output of a mutmut command."""
    done = subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(f"mutmut {' '.join(arguments)}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def main() -> None:
    """Run, and print a count of outcomes and the difference that each survivor makes."""
    if find_spec("mutmut") is None:
        sys.exit("mutmut is not installed: pip install mutmut")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        mutmut(folder, "run", *sys.argv[1:])
        outcomes = [line.strip().rsplit(": ", 1) for line in mutmut(folder, "results", "--all", "true").splitlines()]
        tried = [(mutant, outcome) for mutant, outcome in outcomes if outcome != "not checked"]
        console = Console(highlight=False, markup=False, soft_wrap=True)
        for outcome in sorted({outcome for _, outcome in tried}):
            console.print(f"{outcome:12} {sum(each == outcome for _, each in tried)}")
        for mutant, outcome in tried:
            if outcome != "killed":
                changed = [
                    line for line in mutmut(folder, "show", mutant).splitlines() if re.match(r"[-+](?![-+]{2})", line)
                ]
                console.print(f"\n{mutant}: {outcome}", *changed, sep="\n")


if __name__ == "__main__":
    main()
