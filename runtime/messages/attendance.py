"""What a cell and the person who attends it say to each other when it cannot go on by itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from runtime.declaration import Bool, Text, UInt8, UInt32, message
from runtime.messages.ros import Header

# Words that an attempt's reason holds when it was aborted for one of these; every arm uses the same.
DROPPED_WORDS = "the part was dropped"
PROTECTIVE_STOP_WORDS = "protective stop"
JAM_WORDS = "the part is jammed"


class Need(IntEnum):
    """Why a cell needs a person."""

    NOTHING = 0  # it does not, or no longer
    EXHAUSTED = 1  # the search knows no further position, or its budget is spent
    DROPPED = 2  # the gripper has lost its part
    PROTECTIVE_STOP = 3  # the arm stopped itself
    JAM = 4  # the part went in some way and stuck
    ABORTED = 5  # an attempt ended for another reason


class Choice(IntEnum):
    """What a person can answer."""

    LOOK = 0  # nothing yet: what is needed?
    RETRY = 1  # the same hole again, with a fresh part and a new search
    SKIP = 2  # leave the hole, go on with the next
    ABORT = 3  # end the job


@message
@dataclass(frozen=True, slots=True)
class Intervention:
    """What a cell needs from a person: it waits for an answer. Latched; once it is answered, need is NOTHING."""

    header: Header
    number: UInt32  # of the request within the session, from 1; 0: there has been none
    need: UInt8  # a Need
    search: UInt32
    board: UInt32
    hole: Text
    reason: Text  # what happened
    task: Text  # what the person is to do
    retry: Text  # what this answer leads to; empty if it is not offered
    skip: Text  # likewise
    abort: Text  # likewise

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class InterventionAnswer:
    """A person's answer to a cell that waits."""

    number: UInt32  # of the request that is meant
    choice: UInt8  # a Choice
    who: Text
    note: Text  # for whoever reads the log; may be empty

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class InterventionReply:
    """Whether the answer was taken, and what is needed now."""

    accepted: Bool
    error: Text  # why it was not; empty if it was
    open: Intervention

    __msgtype__: ClassVar[str]


@message
@dataclass(frozen=True, slots=True)
class AnswerGiven:
    """An answer that was taken, for the record and for the arm."""

    header: Header
    number: UInt32  # of the request
    search: UInt32
    board: UInt32
    hole: Text
    choice: UInt8  # a Choice
    who: Text
    note: Text

    __msgtype__: ClassVar[str]
