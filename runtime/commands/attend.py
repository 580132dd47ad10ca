"""palpate attend: see what a running cell needs from a person, and answer it."""

from __future__ import annotations

import argparse
import sys

from rich.console import Console

from runtime.bus import Bus, Envelope
from runtime.commands import operator
from runtime.commands.attendance import PROMPT, answer_of, choice_of, show_request, user
from runtime.config import meeting_point
from runtime.errors import BusError, InputError
from runtime.intervention import answered
from runtime.messages import AnswerGiven, Choice, Intervention, InterventionAnswer, InterventionReply, Need
from runtime.network.meeting_point import MeetingPoint
from runtime.topics import ANSWER, INTERVENTION, SESSION

_LOOK = 2.0  # [s] of waiting between looks whether the cell is still there


def attend_command(arguments: argparse.Namespace) -> int:
    """Show what is needed, or answer it. Raises InputError for an answer that the cell refuses."""
    choice = None if arguments.choice is None else choice_of(arguments.choice)
    point = meeting_point(arguments.cell, arguments.port)
    console = Console()
    with operator.joined(point, _absent(point)) as bus:
        request = _open_request(bus, point, wait=arguments.wait)
        if request is None and choice is None:
            console.print("the cell needs nobody now", highlight=False)
            return 0
        if choice is not None:
            number = arguments.number or (request.number if request else 0)
            if number == 0:
                raise InputError("the cell asks for nothing, so there is nothing to answer; --wait waits until it does")
            answer = InterventionAnswer(number, choice, arguments.who or user(), arguments.note)
            _give(bus, point, answer, request, console)
            return 0
        assert request is not None
        show_request(request, console)
        if sys.stdin.isatty() and sys.stdout.isatty():
            _prompt(bus, point, request, console)
    return 0


def _absent(point: MeetingPoint) -> str:
    return f"no cell answers on {point}; is 'palpate launch --attended' there?"


def _ask(bus: Bus, point: MeetingPoint, answer: InterventionAnswer) -> InterventionReply:
    try:
        return bus.request(ANSWER, answer, operator.ANSWER)
    except BusError:
        raise BusError(_absent(point)) from None


def _look(bus: Bus, point: MeetingPoint) -> Intervention | None:
    """The open request; None if there is none. Raises InputError for a cell that asks nobody."""
    reply = _ask(bus, point, InterventionAnswer(0, Choice.LOOK, user(), ""))
    if not reply.accepted:
        raise InputError(reply.error)
    return None if reply.open.need == Need.NOTHING else reply.open


def _open_request(bus: Bus, point: MeetingPoint, *, wait: bool) -> Intervention | None:
    """The open request, the next one if it is to be waited for. Raises BusError if the cell ends meanwhile."""
    if wait:
        bus.subscribe(INTERVENTION, SESSION)
    request = _look(bus, point)
    while request is None and wait:
        item = bus.inbox.receive(_LOOK)
        if item is None or (isinstance(item, Envelope) and item.topic == INTERVENTION.name):
            request = _look(bus, point)
    return request


def _give(
    bus: Bus, point: MeetingPoint, answer: InterventionAnswer, request: Intervention | None, console: Console
) -> None:
    reply = _ask(bus, point, answer)
    if not reply.accepted:
        raise InputError(reply.error)
    asked = request or reply.open
    given = AnswerGiven(
        asked.header, answer.number, asked.search, asked.board, asked.hole, answer.choice, answer.who, answer.note
    )
    console.print(answered(given), highlight=False, markup=False, soft_wrap=True)


def _prompt(bus: Bus, point: MeetingPoint, request: Intervention, console: Console) -> None:
    """Ask until an answer is understood; end of input leaves the request open."""
    while True:
        try:
            line = console.input(f"{PROMPT}: ", markup=False)
        except EOFError:
            console.print("\nnot answered: the cell still waits", highlight=False)
            return
        try:
            answer = answer_of(line, request)
        except InputError as error:
            console.print(str(error), highlight=False, markup=False)
            continue
        _give(bus, point, answer, request, console)
        return
