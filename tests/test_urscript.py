"""URScript: what scripts mean, and where their errors are."""

import pytest
from urscript_bench import Bench, failure, run, value

from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.values import Pose, Value


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
