"""Scripts that mean no good: none may stall, exhaust or escape from what runs it; and compiling in its own process."""

import os
import random
import select
import signal
import time
from collections.abc import Callable, Generator, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ur3e.urscript.builtin import Builtin
from drivers.ur3e.urscript.compile_worker import Compiler, Result
from drivers.ur3e.urscript.compiler import compile_script
from drivers.ur3e.urscript.errors import ScriptError
from drivers.ur3e.urscript.program import Limits, Program
from drivers.ur3e.urscript.pure_builtins import pure_builtins
from drivers.ur3e.urscript.script import Script

QUICK = Limits(steps=500, patience=10)


def _sync() -> Generator[None, None, None]:
    yield


BUILTINS = pure_builtins(1) | {
    "sync": Builtin(_sync, timed=True),
    "nothing": Builtin(lambda *_: None),
    "text": Builtin(lambda n: "x" * n),
    "slow": Builtin(lambda: None, cost=1000),
}
TIMED = {name: builtin.timed for name, builtin in BUILTINS.items()}


def start(text: str, limits: Limits = QUICK) -> Program:
    return Program(compile_script(text, TIMED), BUILTINS, limits)


def run(text: str, limits: Limits = QUICK, cycles: int = 3000) -> int:
    """Cycles that a script takes to its end."""
    program = start(text, limits)
    for cycle in range(cycles):
        if not program.tick():
            return cycle + 1
    raise AssertionError(f"still running after {cycles} cycles")


def failure(text: str, limits: Limits = QUICK) -> ScriptError:
    with pytest.raises(ScriptError) as caught:
        run(text, limits)
    return caught.value


@pytest.mark.parametrize(
    "loop",
    [
        "while True:\n end",
        "while True:\n pass\n end",
        "i = 0\n while i == i:\n i = 1\n continue\n end",
        "while sin(0) == 0:\n end",
        "while True:\n nothing(1)\n end",
        "while True:\n try = 1\n if try == 1:\n continue\n end\n sync()\n end",
        "def f():\n return 1\n end\n while f() == 1:\n end",
    ],
)
def test_a_loop_that_never_waits_ends_with_an_error(loop: str) -> None:
    error = failure(f"def program():\n {loop}\nend")
    assert error.text.startswith("infinite loop")
    assert error.line > 1


def test_a_long_calculation_takes_several_cycles() -> None:
    assert 2 <= run("i = 0\nwhile i < 1000:\n i = i + 1\nend", Limits(steps=500)) < 20


def test_waiting_now_and_then_is_enough() -> None:
    busy = "i = 0\nwhile i < 30:\n j = 0\n while j < 1000:\n  j = j + 1\n end\n i = i + 1\n sync()\nend"
    assert run(busy) > QUICK.patience


def test_a_busy_thread_leaves_time_for_others() -> None:
    program = start(
        "n = 0\nthread busy():\n while True:\n  pass\n end\nend\nrun busy()\nwhile n < 8:\n n = n + 1\n sync()\nend"
    )
    assert [program.tick() for _ in range(9)] == [True] * 8 + [False]


def test_expensive_builtins_wait_for_the_next_cycle() -> None:
    assert run("slow()\n" * 10, Limits(steps=1000)) >= 8


def test_code_without_loops_waits_too() -> None:
    assert run("a = 1 + 2 * 3\n" * 5000, Limits(steps=500)) > 5


def test_recursion_is_limited() -> None:
    assert "64 deep" in failure("def f(n):\n return f(n + 1)\nend\nf(0)").text
    assert "64 deep" in failure("def f(): g() end\ndef g(): f() end\nf()").text
    run("def f(n):\n if n == 0:\n  return 0\n end\n return f(n - 1)\nend\nf(60)")


def test_threads_are_limited() -> None:
    assert (
        "50 threads" in failure("thread t():\n sync()\n run t()\n run t()\nend\nrun t()\nwhile True: sync() end").text
    )
    assert "50 threads" in failure("thread t():\n while True: sync() end\nend\nwhile True: run t() end").text


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('s = "x"\nwhile True:\n s = str_cat(s, s)\n sync()\nend', "limit is 1023"),
        ("s = text(70000)", "limit is 65535"),
        ("a = [" + "0, " * 5000 + "0]", "limit is 5000"),
        ("r = make_list(99, 0)\na = [" + "r, " * 60 + "r]", "limit is 5000"),
        ("s = struct(a=1)\nwhile True:\n s = struct(a=s, b=s)\n sync()\nend", "deep inside each other"),
        ("a = [[1, 2], [3, 4]]\na[0] = make_list(4000, 1)", "another size"),
        ("a = make_list(70, 1.5)\nm = transpose(a)\nm = m * transpose(m)", "not possible|limit is 5000"),
        ("i = 1\nwhile True:\n i = i * 2\n sync()\nend", "32 bits"),
        ("i = 1.5\nwhile True:\n i = i * i\n sync()\nend", "finite"),
    ],
)
def test_values_are_limited(text: str, why: str) -> None:
    assert any(part in failure(text).text for part in why.split("|"))


def test_what_is_held_altogether_is_limited() -> None:
    many = "".join(f"a{i} = make_list(4000, 0)\n" for i in range(400))
    assert "holds" in failure(many, Limits(values=200_000)).text
    nested = "def f(n):\n x = make_list(4000, 0)\n if n > 50:\n  while True: sync() end\n end\n f(n + 1)\nend\n"
    threads = f"thread t():\n f(0)\nend\n{nested}\n" + "run t()\nsync()\n" * 40 + "while True: sync() end"
    assert "holds" in failure(threads, Limits(steps=10_000)).text  # held by unfinished calls
    run("i = 0\nwhile i < 300:\n a = make_list(4000, 0)\n i = i + 1\nend", Limits(values=200_000))


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "(" * 100_000 + "1" + ")" * 100_000,
        "x = " + "[" * 100_000,
        "x = " + "-" * 100_000 + "1",
        "x = " + "not " * 100_000 + "True",
        "x = 1" + " + 1" * 100_000,
        "x = a" + "[0]" * 100_000,
        "x = a" + ".b" * 100_000,
        "if True:\n" * 10_000 + "end\n" * 10_000,
        "while True:\n" * 10_000 + "end\n" * 10_000,
        "while True:\n" * 19 + "end\n" * 19,
        "def a():\n" * 10_000 + "end\n" * 10_000,
        "if True:\npass\n" + "elif False:\npass\n" * 10_000 + "end\n",
        "x = " + "f(" * 60 + "1" + ")" * 60,
        "x" * 1_000_001,
        "9" * 500_000,
        "x = " + "9" * 500_000,
        "x = 0x" + "f" * 500_000,
        "x = '" + "y" * 500_000,
        "".join(f"v{i} = 1\n" for i in range(11_000)),
        "".join(f"def f{i}(): end\n" for i in range(3_000)) + "x = 1",
        "#" * 10_000_000,
        "\0",
        "\ud800",
        'x = "\ud800" y',
    ],
    ids=lambda text: text[:12].encode("ascii", "backslashreplace").decode(),
)
def test_monstrous_sources_are_refused(text: str) -> None:
    began = time.process_time()
    with pytest.raises(ScriptError):
        compile_script(text, TIMED)
    assert time.process_time() - began < 10


def test_what_is_large_but_reasonable_is_not_refused() -> None:
    run("x = 1" + " + 1" * 90)
    run("if False:\npass\n" + "elif False:\npass\n" * 150 + "end\n")
    run("x = " + "(" * 60 + "1" + ")" * 60)
    run("a = [" + "0, " * 4000 + "0]")
    run("if True:\n" * 30 + "end\n" * 30)


@pytest.mark.parametrize(
    "text",
    [
        "print(1)",
        "eval('1')",
        "__import__('os')",
        "x = __builtins__",
        "_halt()",
        "b_sin(1)",
        "_add(1, 2)",
        "f0_()",
        "x = _meter",
        "x = g_x",
        "s = struct(__class__=1)\nx = s.__dict__",
        "x = (1).__class__",
        "x = sin.__globals__",
        "x = [1].append",
        "sin(**1)",
        "sin(*[1])",
        "x = lambda: 1",
        "import os",
        "sin(f=1, __debug__=2)",
        "nothing(__debug__=1)",
        "def f(__debug__): end\nf(1)",
    ],
)
def test_nothing_of_python_is_reached(text: str) -> None:
    if "def f" in text:
        run(text)
    else:
        failure(text)


def test_a_struct_can_have_any_names() -> None:
    run("s = struct(__class__=1, None_=2, self=3)\ns.__class__ = 4\nx = s.__class__ + s.self")


_KEYWORDS = """
def thread sec end if elif else while break continue return pass halt global local run kill join enter_critical
exit_critical and or not xor True False None
"""  # fmt: skip
_OTHERS = "p x y f g sync sin struct to_str str_cat norm ( ) [ ] , : = == != < + - * / % . 0 1 2.5 'a' # ( ) ="
_WORDS = st.sampled_from([*_KEYWORDS.split(), *_OTHERS.split(), "\n", "\n", "\n", "\t", '"b"'])


def outcome(text: str) -> ScriptError | None:
    """What comes out of compiling and running whatever it is."""
    try:
        program = start(text, Limits(steps=300, patience=5))
        for _ in range(20):
            if not program.tick():
                break
        program.stop()
    except ScriptError as error:
        return error
    return None


def anything(text: str) -> None:
    """Whatever it is, it compiles and runs, or is a ScriptError."""
    error = outcome(text)
    if error is not None:
        assert 1 <= error.line <= text.count("\n") + 1
        assert error.column >= 1
        assert error.text


@given(st.binary(max_size=300))
def test_garbage_is_an_error_and_nothing_else(data: bytes) -> None:
    anything(data.decode("latin-1"))
    anything(data.decode("utf-8", "surrogateescape"))


@settings(max_examples=400)
@given(st.lists(_WORDS, max_size=60))
def test_words_in_any_order_are_an_error_or_a_program(words: list[str]) -> None:
    anything(" ".join(words))


_ATOMS = st.sampled_from(
    ["1", "2.5", "True", "'a'", "x", "[1, 2]", "[[1, 2], [3, 4]]", "p[1,2,3,0,0,1]", "struct(a=1)", "f(1)"]
)
_SIGNS = st.sampled_from(["+", "-", "*", "/", "%", "==", "!=", "<", ">", "and", "or", "xor"])
_EXPRESSIONS = st.recursive(
    _ATOMS,
    lambda inner: st.one_of(
        st.tuples(
            inner, st.sampled_from(["+", "-", "*", "/", "%", "==", "!=", "<", ">", "and", "or", "xor"]), inner
        ).map(" ".join),
        inner.map(lambda e: f"(-({e}))"),
        inner.map(lambda e: f"(not {e})"),
        st.tuples(inner, inner).map(lambda e: f"({e[0]})[{e[1]}]"),
        st.tuples(inner, inner).map(lambda e: f"[{e[0]}, {e[1]}]"),
        st.tuples(st.sampled_from(sorted(BUILTINS)), inner).map(lambda e: f"{e[0]}({e[1]})"),
        st.tuples(st.sampled_from(sorted(BUILTINS)), inner, inner).map(lambda e: f"{e[0]}({e[1]}, {e[2]})"),
    ),
    max_leaves=12,
)


@settings(max_examples=400)
@given(st.lists(_EXPRESSIONS, max_size=4))
def test_whatever_is_calculated_is_a_value_or_an_error(expressions: list[str]) -> None:
    lines = [f"x = {expression}\ny = x\n" for expression in expressions]
    anything("def f(a):\n return a\nend\nx = 0\n" + "".join(lines))


def idle_script() -> str:
    """About 1200 lines: sixty commands as functions, and a loop that asks which one is wanted."""
    lines = ["def server():", "  global wanted = 0", "  keep_running = True"]
    for i in range(60):
        lines += [f"  def command_{i}(a, b=[0, 0, 0, 0, 0, 0]):", "    local q = [0, 0, 0, 0, 0, 0]"]
        lines += [f"    q[{j}] = b[{j}] + a * {j} / 2" for j in range(6)]
        lines += ["    if norm(q) > 1 and a != 0:", "      nothing(q, a)", "    else:", "      wanted = 0", "    end"]
        lines += ["    enter_critical", "    x = pose_inv(p[0, 0, 0, 0, 0, 0])", "    exit_critical"]
        lines += ["    return True", "  end"]
    other = " or ".join(f"wanted != {i}" for i in range(9))
    lines += ["  while keep_running:", f"    if wanted == 0 and ({other}):", "      wanted = 0", "    end"]
    for i in range(60):
        lines += [f"    {'el' if i else ''}if wanted == {i + 1}:", f"      keep_running = command_{i}({i})"]
    return "\n".join([*lines, "    end", "    sync()", "  end", "end"])


def test_an_idle_server_costs_little() -> None:
    program = start(idle_script(), Limits())
    program.tick()
    best = 1.0  # [s]; the least of several, since other processes share the machine
    for _ in range(20):
        began = time.perf_counter()
        for _ in range(100):
            program.tick()
        best = min(best, (time.perf_counter() - began) / 100)
    assert best < 50e-6


@pytest.fixture
def compiler() -> Iterator[Compiler]:
    with Compiler(TIMED) as compiler:
        yield compiler


def results(compiler: Compiler, tickets: list[int], until: float = 60.0) -> list[Result]:
    """What the tickets have become."""
    found: dict[int, Result] = {}
    deadline = time.monotonic() + until
    while len(found) < len(tickets):
        assert time.monotonic() < deadline
        select.select([], [], [], 0.001)
        found.update(compiler.poll())
    return [found[ticket] for ticket in tickets]


def result(compiler: Compiler, text: str) -> Result:
    return results(compiler, [compiler.submit(text)])[0]


def test_the_worker_compiles_as_this_process_does(compiler: Compiler) -> None:
    text = idle_script()
    here, there = compile_script(text, TIMED), result(compiler, text)
    assert isinstance(there, Script)
    assert (there.name, there.kind, there.builtins) == (here.name, here.kind, here.builtins)
    assert Program(there, BUILTINS).tick()
    error = result(compiler, "x = 1\nx = = 2")
    assert isinstance(error, ScriptError)
    assert (error.line, error.column, error.text) == (2, 5, "syntax error: unexpected '='")
    odd = result(compiler, 'x = "\ud800é"')
    assert isinstance(odd, Script)


def test_many_scripts_come_back_under_their_tickets(compiler: Compiler) -> None:
    tickets = [compiler.submit(f"def program_{i}():\nend") for i in range(20)]
    names = [found.name for found in results(compiler, tickets) if isinstance(found, Script)]
    assert names == [f"program_{i}" for i in range(20)]


def test_submitting_and_polling_never_wait(compiler: Compiler) -> None:
    text = "x = [1, 2, 3]\n" * 20_000
    slowest = 0.0
    found: list[tuple[int, Result]] = []
    ticket = compiler.submit(text)
    while not found:
        began = time.thread_time()
        found = compiler.poll()
        slowest = max(slowest, time.thread_time() - began)
        select.select([], [], [], 0.002)
    assert found[0][0] == ticket
    assert slowest < 0.02


def test_a_known_text_is_not_compiled_again(compiler: Compiler) -> None:
    first = result(compiler, "nothing(1)")
    ticket = compiler.submit("nothing(1)")
    assert compiler.poll() == [(ticket, first)]


def test_a_text_too_long_is_refused_at_once(compiler: Compiler) -> None:
    ticket = compiler.submit("#" * 10_000_000)
    [(refused, error)] = compiler.poll()
    assert refused == ticket
    assert "10000000 characters" in str(error)


def test_too_many_scripts_are_refused(compiler: Compiler) -> None:
    tickets = [compiler.submit(f"x = {i}") for i in range(60)]
    found = results(compiler, tickets)
    assert sum(isinstance(f, ScriptError) and "wait to be compiled" in f.text for f in found) >= 20
    assert isinstance(found[0], Script)


def test_a_killed_worker_is_replaced(compiler: Compiler) -> None:
    assert isinstance(result(compiler, "x = 1"), Script)
    pid = compiler.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    ticket = compiler.submit("x = 2")
    compiler.poll()
    os.kill(pid, signal.SIGKILL)
    [lost] = results(compiler, [ticket])
    assert isinstance(lost, ScriptError)
    assert isinstance(result(compiler, "x = 2"), Script)
    assert compiler.pid != pid


def test_a_worker_killed_while_idle_is_replaced_too(compiler: Compiler) -> None:
    assert isinstance(result(compiler, "x = 1"), Script)
    pid = compiler.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    again = result(compiler, "x = 3")  # the process may die just before or just after this is sent
    assert isinstance(again, Script) or isinstance(result(compiler, "x = 3"), Script)


def test_a_script_that_takes_too_long_is_given_up() -> None:
    with Compiler(TIMED, timeout=0.5) as compiler:
        pid = compiler.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        error = result(compiler, "x = 1")
        assert isinstance(error, ScriptError)
        assert "longer than 0.5 s" in error.text
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_closed_compiler_leaves_no_process() -> None:
    compiler = Compiler(TIMED)
    pid = compiler.pid
    assert pid is not None
    compiler.submit("x = 1")
    compiler.close()
    compiler.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_the_worker_dies_with_its_parent() -> None:
    read, write = os.pipe()
    child = os.fork()
    if child == 0:  # the parent of a worker, which ends without closing it
        try:
            orphan = Compiler(TIMED)
            os.write(write, str(orphan.pid).encode())
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    pid = int(os.read(read, 20))
    os.close(read)
    os.close(write)
    gone = _eventually(lambda: not _alive(pid))
    assert gone


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123
        return stat.read().rsplit(")", 1)[1].split()[0] != "Z"


def _eventually(holds: Callable[[], bool], seconds: float = 20.0) -> bool:
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            return False
        select.select([], [], [], 0.01)
    return True


def test_random_texts_do_not_upset_the_worker(compiler: Compiler) -> None:
    noise = random.Random(1)
    texts = ["".join(chr(noise.randrange(0x3000)) for _ in range(noise.randrange(200))) for _ in range(30)]
    found = results(compiler, [compiler.submit(text) for text in texts])
    assert all(isinstance(f, ScriptError) for f in found)
    assert isinstance(result(compiler, "x = 1"), Script)
