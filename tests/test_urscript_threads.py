"""URScript programs as they run: threads, ends, errors in their midst."""

import pytest
from urscript_bench import Bench, failure, run

from drivers.ur3e.urscript.errors import ScriptError


def test_threads_take_turns_in_the_order_they_began() -> None:
    assert run("""
        def program():
          thread worker(name, cycles):
            i = 0
            while i < cycles:
              say([name, i])
              i = i + 1
              sync()
            end
          end
          a = run worker(1, 3)
          b = run worker(2, 1)
          say([a, b])
          sync()
          kill a
          kill 0
          kill 77
          join b
          join a
          say("joined")
        end
    """) == [[2, 3], [1, 0], [2, 0], "joined"]  # fmt: skip


def test_a_thread_waits_for_another() -> None:
    bench = Bench("""
        thread slow():
          wait(3)
          say("slow")
        end
        join run slow()
        say("main")
    """)
    assert [bench.program.tick() for _ in range(5)] == [True, True, True, True, False]
    assert bench.said == ["slow", "main"]


def test_the_end_of_the_program_ends_its_threads() -> None:
    bench = Bench("thread t():\n move([1])\nend\nrun t()\nsync()")
    assert bench.program.tick()
    assert (bench.program.threads, bench.program.current) == (2, 2)
    assert not bench.program.tick()
    assert bench.moves == ["to [1] at 1", "stopped"]
    assert bench.program.threads == 0
    assert not bench.program.tick()


@pytest.mark.parametrize("statement", ["halt", "leave()"])
def test_halt_ends_everything_from_any_thread(statement: str) -> None:
    bench = Bench(f"thread t():\n sync()\n {statement}\nend\nrun t()\nmove([2], speed=0.5)\nwait(9)")
    assert [bench.program.tick() for _ in range(3)] == [True, False, False]
    assert bench.moves == ["to [2] at 0.5", "stopped"]


def test_a_killed_motion_is_stopped_at_once() -> None:
    bench = Bench('thread t():\n move([1])\nend\nt1 = run t()\nsync()\nkill t1\nsay("killed")\nsync()')
    bench.program.tick()
    bench.program.tick()
    assert (bench.moves, bench.said) == (["to [1] at 1", "stopped"], ["killed"])


def test_a_thread_can_kill_itself() -> None:
    assert run('me = 0\nthread t():\n kill me\n say("alive")\nend\nme = run t()\nwait(2)\nsay("over")') == ["over"]


def test_stopping_closes_what_runs() -> None:
    bench = Bench("move([1])")
    bench.program.tick()
    bench.program.stop()
    bench.program.stop()
    assert (bench.moves, bench.program.threads) == (["to [1] at 1", "stopped"], 0)


def test_an_error_in_a_thread_ends_the_program_and_says_where() -> None:
    bench = Bench("thread t():\n sync()\n a = [1]\n a[\n  7] = 1\nend\nrun t()\nmove([1])\nwait(9)")
    assert bench.program.tick()
    with pytest.raises(ScriptError, match="index 7") as caught:
        bench.program.tick()
    assert (caught.value.line, caught.value.column) == (4, 3)
    assert bench.moves == ["to [1] at 1", "stopped"]
    assert not bench.program.tick()


def test_the_line_is_that_of_the_innermost_function_of_the_script() -> None:
    error = failure("def program():\n def f(x):\n  y = 1\n  return x / 0\n end\n say(\n  f(2))\nend")
    assert (error.line, str(error)) == (4, "line 4, column 12: division by zero")


def test_pause_is_told() -> None:
    bench = Bench("pause\nsay(1)")
    assert bench.program.tick()
    assert bench.program.wants_pause
    assert bench.run() == [1]


@pytest.mark.parametrize(
    ("text", "line", "column", "why"),
    [
        ("x = ", 1, 3, "ends too early"),
        ("if True:\n x = 1\n", 2, 7, "`end`"),
        ("x = (1\n", 1, 6, "bracket"),
        ("x = 1 +* 2", 1, 8, "'*'"),
        ("a = 1\nfor i in l:\nend", 2, 5, "no `for`"),
        ("switch (a):\nend", 1, 11, "`switch` is not simulated"),
        ('s = "abc\n', 1, 5, "no closing"),
        ("x = 1 $ 2", 1, 7, "'$'"),
        ("end", 1, 1, "'end'"),
        ("break", 1, 1, "outside of a loop"),
        ("x = 1 = 2", 1, 7, "'='"),
        ("x", 1, 1, "ends too early"),
        ("p[1, 2, 3] = 4", 1, 2, "one or two indices"),
        ("x = p[1, 2, 3]", 1, 6, "a pose has six"),
        ("global a[0] = 1", 1, 9, "'['"),
        ("x = None", 1, 1, "None"),
        ("x = 1e999", 1, 5, "too large"),
        ("def a():\n if True:\n  def f():\n  end\n end\nend", 3, 3, "inside of an `if`"),
        ("def a():\n def f():\n end\n def f():\n end\nend", 4, 2, "already defined on line 2"),
        ("def a():\n def f(x, x):\n end\nend", 2, 11, "two parameters"),
        ("def a():\n sec f():\n end\nend", 2, 2, "`sec`"),
    ],
)
def test_what_is_no_urscript(text: str, line: int, column: int, why: str) -> None:
    with pytest.raises(ScriptError) as caught:
        Bench(text)
    assert why in caught.value.text
    assert (caught.value.line, caught.value.column) == (line, column)
