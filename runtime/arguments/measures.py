"""Arguments of the commands that measure and compare."""

from __future__ import annotations

from runtime.arguments.parser import Commands, add, seconds

EXPERIMENT = """\
examples:
  palpate experiment                                           what can be tried
  palpate experiment compare                                   every strategy in every world, on the statistical model
  palpate experiment compare --seeds 20 --strategies meta,bayes --worlds realistic
  palpate experiment compare --physics --seeds 3 --out out     in full MuJoCo physics
  palpate experiment robustness --executor dask://node1:8786   on a dask cluster

Results are kept in the user's cache: a run that was stopped goes on where it was, and what has not changed
is not computed again. Tables (CSV, Markdown) and figures (PNG, SVG) go to experiments/NAME or --out DIR."""


def add_experiment(commands: Commands) -> None:
    """palpate experiment."""
    experiment = add(
        commands,
        "experiment",
        "compare strategies over many simulated worlds",
        EXPERIMENT,
        "runtime.commands.experiment:experiment_command",
    )
    experiment.add_argument(
        "name", nargs="?", default="list", metavar="NAME", help="of the experiment; list tells what there is (default)"
    )
    experiment.add_argument("--seeds", type=int, metavar="N", help="worlds to draw (default: the experiment's own)")
    experiment.add_argument("--boards", type=int, metavar="N", help="boards to work through in each (default: 10)")
    experiment.add_argument(
        "--physics",
        action="store_true",
        help="in full MuJoCo physics instead of the statistical model; a tenth of the seeds unless --seeds says more",
    )
    experiment.add_argument("--strategies", metavar="A,B,...", help="instead of the experiment's own")
    experiment.add_argument("--worlds", metavar="A,B,...", help="instead of the experiment's own")
    experiment.add_argument("--components", metavar="A,B,...", help="igbt, capacitor")
    experiment.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one for each core)")
    experiment.add_argument(
        "--executor",
        default="joblib",
        metavar="E",
        help="joblib: this machine (default); dask://HOST:PORT or ray://HOST:PORT: a cluster",
    )
    experiment.add_argument("--out", metavar="DIR", help="where tables and figures go (default: experiments/NAME)")
    experiment.add_argument(
        "--cache", metavar="DIR", help="where results are kept (default: palpate in the user's cache directory)"
    )


BENCH = """\
examples:
  palpate bench sim                               real-time factors of physics, controller and whole cell
  palpate bench sim --cell capacitor --json figures.json
  palpate bench robot --seconds 20                packages on time, round trips, late cycles
  palpate bench plan --strategy bayes,meta        milliseconds of thought before each candidate
  palpate bench bus --seconds 20                  round trips and floods beside raw Zenoh, pyzmq and ROS 2
  palpate bench log --log logs/x.mcap             messages recorded per second, and how soon a log can be seen
  palpate bench safety --trials 1000              milliseconds from a broken beam to the stop, and the safe distance
  palpate bench faults                            strike a cell with every fault there is, and judge what became of it
  palpate bench faults --only 'kill -9 *,NaN' --tries 5
  palpate bench faults --list                     the faults, in words"""


def add_bench(commands: Commands) -> None:
    """palpate bench."""
    bench = add(commands, "bench", "measure on this machine", BENCH, "runtime.commands.bench:bench_command")
    bench.add_argument(
        "what",
        choices=("sim", "robot", "plan", "bus", "log", "safety", "faults"),
        help="sim: real-time factors of physics, controller and whole cell; "
        "robot: how punctual the simulated controller is for two clients on the network; "
        "plan: how long strategies think before each candidate; "
        "bus: round trips and floods, beside raw Zenoh and what else is installed; "
        "log: messages recorded per second, beside other writers; "
        "safety: how soon the arm stops when the light curtain is interrupted, thousands of times; "
        "faults: what becomes of a cell whose processes are killed, stopped and slowed, and of others' messages; "
        "exit code 1 if it broke a promise",
    )
    bench.add_argument(
        "--seconds",
        type=seconds,
        default=60.0,
        metavar="S",
        help="robot: how long to measure; bus, log: about how long, as it scales the number of messages (default: 60)",
    )
    bench.add_argument(
        "--messages",
        type=int,
        metavar="N",
        help="bus, log: how many each contender sends or writes (default: 100000 in 60 s)",
    )
    bench.add_argument("--contenders", metavar="A,B,...", help="bus, log: only these (default: all that are installed)")
    bench.add_argument("--log", metavar="LOG", help="log: also measure how soon this log can be seen in Rerun")
    bench.add_argument("--cell", default="igbt", metavar="CELL", help="a cell file or a shipped name (default: igbt)")
    bench.add_argument("--strategy", metavar="NAME", help="instead of the cell's own; plan: one or more, with commas")
    bench.add_argument("--seed", type=int, metavar="S", help="instead of the cell's own")
    bench.add_argument("--port", type=int, metavar="PORT", help="of the Zenoh router (sim: 7447, else a free one)")
    bench.add_argument(
        "--trials",
        type=int,
        metavar="N",
        help="safety: how many beams to break (default: 10000; 250 at rate 1.0); with both rates a fortieth of it more "
        "at 1.0. 1000 take about a minute at full speed, and 20 at rate 1.0",
    )
    bench.add_argument(
        "--rate",
        choices=("1.0", "max", "both"),
        default="both",
        help="safety: at real time, as fast as the machine allows, or both (default)",
    )
    bench.add_argument(
        "--response", type=float, default=15.0, metavar="MS", help="safety: of the light curtain itself (default: 15)"
    )
    bench.add_argument(
        "--resolution", type=float, default=14.0, metavar="MM", help="safety: of the light curtain (default: 14)"
    )
    bench.add_argument(
        "--tries", type=int, default=1, metavar="N", help="faults: with each fault, at other moments (default: 1)"
    )
    bench.add_argument(
        "--only", metavar="A,B,...", help="faults: those whose names contain one of these, or match it with wildcards"
    )
    bench.add_argument("--list", action="store_true", help="faults: only tell what there is")
    bench.add_argument("--json", metavar="FILE", help="write the figures there as name: number")
