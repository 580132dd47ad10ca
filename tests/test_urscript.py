"""URScript: what scripts mean, where their errors are, and what the builtins without a robot calculate."""

import math
import textwrap
from collections.abc import Generator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ur3e import frames
from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.compiler import compile_script
from drivers.ur3e.urscript.errors import BuiltinError, Halt, ScriptError
from drivers.ur3e.urscript.program import Limits, Program
from drivers.ur3e.urscript.pure_builtins import pure_builtins
from drivers.ur3e.urscript.values import Pose, Value, written


class Bench:
    """A program with what it said and what its builtins saw."""

    def __init__(self, text: str, seed: int = 1, limits: Limits | None = None) -> None:
        self.said: list[Value] = []
        self.moves: list[str] = []
        self.internal = [1.0, 2.0, 3.0]
        builtins = pure_builtins(seed) | {
            "say": Builtin(self._say),
            "textmsg": Builtin(lambda s1, s2="": self.said.append(written(s1) + written(s2))),
            "sync": Builtin(self._wait, timed=True),
            "wait": Builtin(self._wait, timed=True),
            "move": Builtin(self._move, timed=True),
            "joints": Builtin(lambda: self.internal),
            "refuse": Builtin(self._refuse),
            "leave": Builtin(self._leave),
        }
        self.script = compile_script(textwrap.dedent(text), {name: b.timed for name, b in builtins.items()})
        self.program = Program(self.script, builtins, limits)

    def _say(self, value: Value) -> None:
        self.said.append(value)

    def _wait(self, cycles: int = 1) -> Generator[None, None, int]:
        for _ in range(cycles):
            yield
        return cycles

    def _move(self, target: Value, speed: float = 1.0) -> Generator[None, None, None]:
        self.moves.append(f"to {written(target)} at {written(speed)}")
        try:
            yield
            yield
        finally:
            self.moves.append("stopped")

    def _refuse(self, what: str) -> None:
        raise BuiltinError(f"no {what} here")

    def _leave(self) -> None:
        raise Halt

    def run(self, cycles: int = 1000) -> list[Value]:
        """Tick until the program ends."""
        for _ in range(cycles):
            if not self.program.tick():
                return self.said
        raise AssertionError(f"still running after {cycles} cycles")


def run(text: str) -> list[Value]:
    return Bench(text).run()


def value(expression: str) -> Value:
    return run(f"say({expression})")[0]


def failure(text: str) -> ScriptError:
    """What a script is told, when compiled or when run."""
    with pytest.raises(ScriptError) as caught:
        run(text)
    return caught.value


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 2 * 3 - 4", 3),
        ("(1 + 2) * 3", 9),
        ("3 / 2", 1.5),
        ("4 / 2", 2.0),
        ("7 % 3", 1),
        ("-7 % 3", -1),
        ("7.5 % 2", 1.5),
        ("-2 * -3", 6),
        ("2 - -3", 5),
        ("0x1F", 31),
        (".5 + 1. + 1e-1", 1.6),
        ("1 < 2", True),
        ("2 <= 1", False),
        ("1 == 1.0", True),
        ("1 != 2", True),
        ("True == 1", False),
        ("\"a\" == 'a'", True),
        ("not 1 > 2", True),
        ("not True == False", True),
        ("True and False or True", True),
        ("True xor True", False),
        ("False xor True", True),
        ("True or False and False", True),
        ("[1, 2] + [3, 4]", [4, 6]),
        ("[1, 2] * [3, 4]", [3, 8]),
        ("2 * [1, 2.5]", [2, 5.0]),
        ("[1, 2] * 2", [2, 4]),
        ("[1, 2] / 2", [0.5, 1.0]),
        ("10 / [10, 20]", [1.0, 0.5]),
        ("-[1, -2]", [-1, 2]),
        ("5 - [[10, 20], [30, 40]]", [[-5, -15], [-25, -35]]),
        ("121 % [[10, 20], [30, 40]]", [[1, 1], [1, 1]]),
        ("[[1,2],[3,4],[5,6]] * [[10,20,30],[40,50,60]]", [[90, 120, 150], [190, 260, 330], [290, 400, 510]]),
        ("[[1,2],[3,4],[5,6]] * [10, 20]", [50, 110, 170]),
        ("p[1, 2, 3, 0, 0, 0] + p[1, 1, 1, 0, 0, 1]", Pose([2, 3, 4, 0, 0, 1])),
        ("p[1, 2, 3, 0, 0, 0] * 2", Pose([2, 4, 6, 0, 0, 0])),
        ("-p[1, 2, 3, 0, 0, 0]", Pose([-1, -2, -3, 0, 0, 0])),
        ("p[1, 2, 3, 0, 0, 0][1]", 2.0),
        ("[[1, 2], [3, 4]][1, 0]", 3),
        ("[[1, 2], [3, 4]][1][0]", 3),
        ("[1, 2, 3][4 / 2]", 3),
        ("[1, 2] == [1, 2]", True),
        ("struct(a=1, b=[1, 2]).b[1]", 2),
        ("[]", []),
        ("2147483647", 2147483647),
        ("2147483648", 2147483648.0),
    ],
)
def test_expressions(expression: str, expected: Value) -> None:
    got = value(expression)
    assert got == expected
    assert type(got) is type(expected)


@pytest.mark.parametrize(
    ("expression", "why"),
    [
        ("1 / 0", "division by zero"),
        ("1 % 0", "modulo by zero"),
        ("2147483647 + 1", "32 bits"),
        ("1e308 * 10", "finite"),
        ('"a" + "b"', "str_cat joins strings"),
        ("True + 1", "truth value + number"),
        ("[1, 2] + [1, 2, 3]", "2 and 3 elements"),
        ("[[1, 2]] * [1, 2, 3]", "sizes do not match"),
        ("[1, 2] * [[1, 2]]", "not possible"),
        ("p[0,0,0,0,0,0] * p[0,0,0,0,0,0]", "not possible"),
        ("p[0,0,0,0,0,0] + [0,0,0,0,0,0]", "not possible"),
        ("[1, True]", "both a number and a truth value"),
        ("[[1], [1, 2]]", "equally long"),
        ("[[[1]]]", "no deeper than a matrix"),
        ("[1, 2][2]", "index 2"),
        ("[1, 2][-1]", "index -1"),
        ("[1, 2][0.5]", "whole number"),
        ("[1, 2][True]", "whole number"),
        ("(1)[0]", "no elements"),
        ("[1, 2][0, 0]", "need a matrix"),
        ("1 and True", "True or False"),
        ("not 1", "True or False"),
        ("True < False", "no order"),
        ('"a" < "b"', "no order"),
        ("struct(a=1).b", "it has a"),
        ("p[1, True, 0, 0, 0, 0]", "number"),
        ("sqrt(-1)", "sqrt: -1 is outside"),
        ("sqrt(1, 2)", "too many positional"),
        ("sqrt(g=1)", "missing|unexpected"),
        ('refuse("tea")', "refuse: no tea here"),
    ],
)
def test_expressions_that_are_errors(expression: str, why: str) -> None:
    error = failure(f"\n\nsay({expression})")
    assert error.line == 3
    assert any(part in error.text for part in why.split("|"))


def test_flow() -> None:
    assert run("""
        def flow():
          i = 0
          while True:
            i = i + 1
            if i == 2:
              continue
            elif i == 4: say("four")
            elif (i > 5):
              break
            else:
              pass
            end
            say(i)
          end
          enter_critical
          say("over")
          exit_critical
          return
          say("never")
        end
    """) == [1, 3, "four", 4, 5, "over"]  # fmt: skip


def test_lines_go_on_and_statements_need_no_line_end() -> None:
    assert run(
        "def lines():\r\n"
        "\tglobal a = # nothing yet\n0    global b = 2 if True: c = 3 d = 4 end\r\n"
        "\tsay([a,\n b, # inside\n\n c,\n d])\n"
        "  say(a == 0 and\n     b == 2 or\n  False)\n"
        "  e = 1 +\n 1 say(e) say(\n'#no comment'\n)\n"
        "end\n\n# over"
    ) == [[0, 2, 3, 4], True, 2, "#no comment"]  # fmt: skip


def test_a_line_that_is_over_does_not_go_on() -> None:
    assert failure("a = 1\n- 2").line == 2
    assert failure("a = say\n(2)").line == 2


def test_a_return_ends_with_its_line() -> None:
    assert run("""
        def program():
          def f(x):
            if x: return
            end
            say("after")
            return
          end
          f(True)
          f(False)
        end
    """) == ["after"]  # fmt: skip


def test_functions_take_defaults_and_names() -> None:
    assert run("""
        def program():
          base = 10
          def f(a, b=2, c=base + 1):
            return [a, b, c]
          end
          say(f(1))
          say(f(1, c=3))
          say(f(c=7, a=5, b=6))
          base = 20
          say(f(0))
          def fac(n):
            if n < 2:
              return 1
            end
            return n * fac(n - 1)
          end
          say(fac(5))
          f(9)
        end
    """) == [[1, 2, 11], [1, 2, 3], [5, 6, 7], [0, 2, 21], 120]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "why"),
    [
        ("f()", "no value is given for 'a'"),
        ("f(1, 2, 3)", "takes 2 arguments, not 3"),
        ("f(1, a=2)", "'a' is given twice"),
        ("f(b=1, 2)", "must come first"),
        ("f(1, d=2)", "no parameter 'd'"),
        ("t()", "run t()"),
        ("run f(1)", "`run` starts a thread, and 'f' is a function"),
        ("run u()", "'u' is not defined; did you mean 't'?|known: t"),
        ("fff(1)", "no function 'fff' is known"),
        ("textmgs(1)", "did you mean textmsg?"),
        ("struct(1)", "struct takes named values"),
    ],
)
def test_calls_are_checked_before_anything_runs(call: str, why: str) -> None:
    with pytest.raises(ScriptError) as caught:
        Bench(f"say(1)\ndef f(a, b=0): return a end\nthread t(): sync() end\n  {call}")
    assert caught.value.line == 4
    assert any(part in caught.value.text for part in why.split("|"))


def test_names_that_are_no_keywords() -> None:
    assert run("""
        def program():
          p = [1, 2]
          async = p[0]
          p[1] = 5
          lambda = p[0]
          None_ = 1
          def norm2(p, class):
            p[0] = class
            return p
          end
          say(norm2(p, 9))
          say(p)
          say(p[0, 0, 0, 0, 0, async])
          __class__ = 3
          say(__class__)
          norm = 4
          say(norm(-norm))
        end
    """) == [[9, 5], [1, 5], Pose([0, 0, 0, 0, 0, 1]), 3, 4]  # fmt: skip


def test_bare_statements_are_a_program() -> None:
    bench = Bench('say("here")')
    assert (bench.program.name, bench.program.kind) == ("", "def")
    assert bench.run() == ["here"]
    assert run("x = 3\ndef f(): return x end\nsay(f())") == [3]


def test_what_kind_of_program_it_is() -> None:
    assert (Bench("sec tiny():\n say(1)\nend").program.kind, Bench("def big():\nend").program.name) == ("sec", "big")
    assert "second one" in failure("def a():\nend\ndef b():\nend").text
    assert failure("def a(x):\nend").text == "a program takes no arguments"
    assert "empty" in failure("# nothing\n\n").text


def test_variables_of_the_program_are_global() -> None:
    assert run("""
        def program():
          a = 0
          local b = 0
          def f():
            a = 1
            b = 1
            c = 1
            local d = 1
            global e = 1
          end
          c = 5
          d = 5
          f()
          say([a, b, c, d, e])
        end
    """) == [[1, 1, 1, 5, 1]]  # fmt: skip


def test_a_local_hides_the_global_of_its_function_only() -> None:
    assert run("""
        def program():
          global a = 0
          def outer():
            local a = 1
            def inner():
              a = 2
            end
            inner()
            say(a)
          end
          outer()
          say(a)
          def takes(a):
            a = 7
          end
          takes(1)
          say(a)
        end
    """) == [1, 2, 2]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "line", "name"),
    [
        ("def a():\n say(1)\n say(x)\nend", 3, "x"),
        ("def a():\n def f():\n  say(x)\n  x = 1\n end\n f()\nend", 3, "x"),
        ("def a():\n def f():\n  y = 1\n end\n f()\n say(\n  y)\nend", 7, "y"),
        ("if False: v_x = 1 end\nsay(v_x)", 2, "v_x"),
    ],
)
def test_a_variable_without_a_value_is_named(text: str, line: int, name: str) -> None:
    error = failure(text)
    assert (error.line, error.text) == (line, f"the variable {name!r} has no value")


def test_values_are_never_shared() -> None:
    bench = Bench("""
        def program():
          a = [1, 2]
          b = a
          b[0] = 9
          m = [a, a]
          m[0, 1] = 8
          m[1][0] = 7
          row = m[0]
          row[0] = 6
          s = struct(l=a)
          s.l[0] = 5
          def change(x):
            x[0] = 4
            return x
          end
          c = change(a)
          def give():
            return a
          end
          d = give()
          d[0] = 3
          j = joints()
          j[0] = 0
          say([a, b, row, c, d])
          say(m)
          say(s.l)
          say(joints())
        end
    """)
    bench.run()
    assert bench.said == [
        [[1, 2], [9, 2], [6, 8], [4, 2], [3, 2]],
        [[1, 8], [7, 2]],
        [5, 2],
        [1.0, 2.0, 3.0],
    ]
    assert bench.internal == [1.0, 2.0, 3.0]


def test_a_builtin_keeps_what_it_was_given() -> None:
    bench = Bench("a = [1, 2]\nsay(a)\na[0] = 5")
    assert bench.run() == [[1, 2]]


@pytest.mark.parametrize(
    "assignment",
    [
        "a[0] = True",
        "a[3] = 1",
        "m[0] = [1]",
        "m[0] = 1",
        "m[0, 5] = 1",
        "s.x = 1",
        "s.a = [1]",
        "n[0] = 1",
        "q[0] = []",
    ],
)
def test_what_is_inside_keeps_its_kind_and_size(assignment: str) -> None:
    error = failure(f"a = [1, 2]\nm = [[1, 2], [3, 4]]\ns = struct(a=1)\nn = 3\nq = p[0,0,0,0,0,0]\n{assignment}")
    assert error.line == 6


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


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("atan2(1, 2)", math.atan2(1, 2)),
        ("ceil(1.43)", 2),
        ("floor(-1.5)", -2),
        ("d2r(180)", math.pi),
        ("r2d(acos(0))", 90.0),
        ("log(10, 4)", 0.60206),
        ("pow(5., 3)", 125.0),
        ("norm(-5.3)", 5.3),
        ("norm(-8)", 8),
        ("norm([3, 4])", 5.0),
        ("norm(p[-.2, .2, -.2, -1.57, 0, 3.14])", 3.52768),
        ("normalize([0, 1, 1])", [0, math.sqrt(0.5), math.sqrt(0.5)]),
        ("binary_list_to_integer([True, False, False, True])", 9),
        ("binary_list_to_integer(integer_to_binary_list(-57))", -57),
        ("get_list_length([1, 3, 3, 6, 2])", 5),
        ('length("here I am")', 9),
        ("size([[1, 2], [3, 4], [5, 6]])", [3, 2]),
        ("transpose([[1, 2], [3, 4], [5, 6]])", [[1, 3, 5], [2, 4, 6]]),
        ("transpose([1, 2])", [[1], [2]]),
        ("transpose([[1], [2]])", [1, 2]),
        ("inv([[0, 1, 0], [0, 0, 1], [1, 0, 0]])", [[0, 0, 1], [1, 0, 0], [0, 1, 0]]),
        ("inv([[4, 7], [2, 6]])", [[0.6, -0.7], [-0.2, 0.4]]),
        ("inv(p[.2, .5, .1, 1.57, 0, 3.14])", [0.19324, 0.41794, -0.29662, 1.23993, 0.0, 2.47985]),
        ("interpolate_pose(p[.2, .2, .4, 0, 0, 0], p[.2, .2, .6, 0, 0, 0], .5)", [0.2, 0.2, 0.5, 0, 0, 0]),
        ("pose_add(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0.4, 1.0, 0.7, 3.14, 0, 0]),
        ("pose_sub(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0, 0, -0.5, 0, 0, 0]),
        ("pose_trans(p[.2, .5, .1, 1.57, 0, 0], p[.2, .5, .6, 1.57, 0, 0])", [0.4, -0.0996, 0.60048, 3.14, 0, 0]),
        ("rotvec2rpy([3.14, 1.57, 0])", [-2.80856, -0.16202, 0.9]),
        ("rpy2rotvec([3.14, 1.57, 0])", [2.22153, 0.00177, -2.21976]),
        ("point_dist(p[.2, .5, .1, 1.57, 0, 3.14], p[.2, .5, .6, 0, 1.57, 3.14])", 0.5),
        ("pose_dist(p[0, 0, 0, 0, 0, 0], p[3, 0, 0, 0, 0, 0])", 3.0),
        ("wrench_trans(p[0, 1, 0, 0, 0, 0], [0, 0, 2, 0, 0, 0])", [0, 0, 2, 2, 0, 0]),
        ("make_list(3, 7)", [7, 7, 7]),
    ],
)
def test_builtins_on_numbers_lists_and_poses(call: str, expected: Value) -> None:
    got = value(call)
    if isinstance(expected, list) and expected and isinstance(expected[0], list):
        assert got == [pytest.approx(row, abs=2e-5) for row in expected]
    else:
        assert got == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("to_str(10)", "10"),
        ("to_str(2.123456123456)", "2.123456"),
        ("to_str(0.5)", "0.5"),
        ("to_str(-0.0000001)", "0"),
        ("to_str(100000000.0)", "100000000"),
        ("to_str(p[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])", "p[1, 2, 3, 4, 5, 6]"),
        ("to_str([True, False, True])", "[True, False, True]"),
        ('str_cat("Integer ", 1)', "Integer 1"),
        ("str_cat([True], [1, 0])", "[True][1, 0]"),
        ('str_cat(str_cat("", str_cat("One", "Two")), str_cat(3, 4))', "OneTwo34"),
        ('str_at("Hello", 1)', "e"),
        ('str_empty("")', True),
        ('str_find("Hello World!", "o", 5)', 7),
        ('str_find("abc", "z")', -1),
        ('str_len("Hello")', 5),
        ('str_len("é")', 2),
        ('str_cat(str_at("é", 0), str_at("é", 1))', "é"),
        ('str_sub("0123456789abcdefghij", 5, 3)', "567"),
        ('str_sub("0123456789abcdefghij", 10)', "abcdefghij"),
        ('str_sub("abc", 2, 0)', ""),
        ('str_sub("abcde", 2, len=50)', "cde"),
        ('to_num("10")', 10),
        ('to_num(" -3.0e5")', -3.0e5),
        ('to_num("+5.")', 5.0),
        ('to_num("0X3A")', 58),
    ],
)
def test_builtins_on_strings(call: str, expected: Value) -> None:
    got = value(call)
    assert (got, type(got)) == (expected, type(expected))


@pytest.mark.parametrize(
    "call",
    [
        'str_at("Hello", 10)',
        'str_sub("abcde", -5, 50)',
        'to_num("123abc")',
        'to_num("inf")',
        "acos(2)",
        "log(1, 2)",
        "pow(-8, 0.5)",
        "pow(0, -1)",
        "pow(1e300, 2)",
        "inv([[1, 2], [2, 4]])",
        "normalize([0, 0])",
        "pose_inv([1, 2, 3])",
        "get_list_length(3)",
        'sin("a")',
        "make_list(5001, 0)",
        "binary_list_to_integer([1])",
    ],
)
def test_builtins_refuse_what_has_no_result(call: str) -> None:
    assert failure(call).text.startswith(call.split("(", maxsplit=1)[0] + ": ")


def test_random_repeats_with_its_seed() -> None:
    text = "say(random())\nsay(random())"
    assert Bench(text, seed=3).run() == Bench(text, seed=3).run() != Bench(text, seed=4).run()


_NUMBERS = st.floats(-3, 3)
_POSES = st.lists(_NUMBERS, min_size=6, max_size=6).map(Pose)
_PURE = pure_builtins(1)


def call(name: str, *arguments: Value) -> Value:
    return _PURE[name].call(*arguments)


def close(a: Pose, b: Pose) -> bool:
    """Whether two poses are the same, in whichever way their rotation is written."""
    same = frames.product(frames.rotation_of_vector(a[3:]), frames.transpose(frames.rotation_of_vector(b[3:])))
    return math.dist(a[:3], b[:3]) < 1e-6 and math.hypot(*frames.vector_of_rotation(same)) < 1e-6


@given(_POSES, _POSES)
def test_a_pose_and_its_inverse_cancel(a: Pose, b: Pose) -> None:
    assert close(call("pose_trans", a, call("pose_inv", a)), Pose([0.0] * 6))
    assert close(call("pose_trans", call("pose_inv", a), call("pose_trans", a, b)), b)


@given(_POSES, _POSES)
def test_adding_what_was_subtracted_gives_the_pose_again(a: Pose, b: Pose) -> None:
    assert close(call("pose_add", call("pose_sub", a, b), b), a)
    assert close(call("interpolate_pose", a, b, 0), a)
    assert close(call("interpolate_pose", a, b, 1), b)


@given(st.lists(_NUMBERS, min_size=3, max_size=3))
def test_roll_pitch_yaw_and_rotation_vector_are_the_same_rotation(vector: list[float]) -> None:
    back = call("rpy2rotvec", call("rotvec2rpy", vector))
    assert close(Pose([0.0, 0.0, 0.0, *back]), Pose([0.0, 0.0, 0.0, *vector]))


@given(_POSES, st.lists(_NUMBERS, min_size=6, max_size=6), _POSES)
def test_wrenches_follow_poses(a: Pose, wrench: list[float], b: Pose) -> None:
    stepwise = call("wrench_trans", a, call("wrench_trans", b, wrench))
    assert stepwise == pytest.approx(call("wrench_trans", call("pose_trans", a, b), wrench), abs=1e-6)
