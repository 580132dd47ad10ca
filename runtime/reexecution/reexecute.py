"""Feeds what the deciders of a recorded session heard through today's code, and compares what it decides.

Strategy, posterior, assembly and interlock are pure, so the same inputs in the same order on the same clock give the
same decisions. Each topic of inputs has one publisher, whose order the log keeps. Between publishers no order is
promised, so the recorder may have heard another than the decider did. Where two meet, this is why it does not matter:

- Strategy (goals, attempts): it answers only attempts of the search in hand, in the order of their numbers, and the
  assembly sets the next goal only after all attempts of the search before. So a candidate depends on its goal and the
  attempts before it, and its stamp, the latest heard, is the later of theirs.
- Assembly (attempts, candidates): a search is over with the attempt that seats the part, or once both the last attempt
  and the word that no candidate is left are here. No candidate is later than the attempt it leads to. Word that the
  session closes may be heard before a last result or after it: the result's own stamp tells.
- Posterior (attempts, results): a search is stored when the result and all its attempts are here, and the assembly
  waits for that before it sets the next goal. What others add to the store or forget meanwhile, it lets in only
  then, and says so in the log.
- Interlock (OSSD, resets, emergency stops, muting): here order matters; each permit says how many of each were heard
  before it. Older logs do not: there each permit answers one message, and carries the stamp of the OSSD message heard
  last.

What was known before the session stands in its first goal. What people answered in an attended cell is taken from the
log: when, and what.
"""

from __future__ import annotations

from runtime import roles
from runtime.clock import Stopwatch
from runtime.config import strategy_of
from runtime.errors import LogError
from runtime.log.file import LogFile
from runtime.reexecution.interlock import check_interlock
from runtime.reexecution.job import check_job
from runtime.reexecution.session import recorded_session
from runtime.reexecution.strategy import check_strategy
from runtime.reexecution.verdict import DECISIONS, Verdict


def reexecute(log: LogFile) -> Verdict:
    """Compare every recorded decision with today's.

    Raises LogError if the log holds no decision, InputError if its settings or strategy are unknown today, and
    SessionError if today's code fails on the recorded inputs.
    """
    reading = Stopwatch()
    session = recorded_session(log)
    read = reading.seconds
    if not any(session.messages[topic.name] for topic in DECISIONS):
        raise LogError(f"{log.path}: the log holds no decisions: none of {', '.join(t.name for t in DECISIONS)}")
    verdict = Verdict(session)
    strategy = strategy_of(session.cell(roles.STRATEGY), session.where)
    deciding = Stopwatch()
    check_strategy(verdict, strategy)
    check_job(verdict)
    check_interlock(verdict)
    verdict.seconds = read + deciding.seconds
    if not verdict.compared:
        why = "; ".join(verdict.losses) or "what its decisions rest on was not recorded"
        raise LogError(f"{log.path}: none of its decisions can be compared: {why}")
    return verdict
