"""Help pages: every problem of the API and every fault of a file, with a real report."""

from dataclasses import dataclass
from functools import cache

from exceptiondrive_schemas.check.messages import MESSAGES
from exceptiondrive_schemas.faults import FaultCode, FaultGroup
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.publish.broken_files import report_of
from exceptiondrive_server.pages.problem_help import PROBLEM_HELP, Help

SHOWN_EXAMPLES = 4


@dataclass(frozen=True)
class FaultHelp:
    """A fault of a submission file: the checker's own sentence and its report of such a file."""

    code: FaultCode
    title: str
    happened: str
    remedy: str
    group: FaultGroup


@dataclass(frozen=True)
class HelpIndex:
    """All codes."""

    problems: tuple[tuple[ProblemCode, Help], ...]
    faults: tuple[tuple[FaultCode, str], ...]


def help_index() -> HelpIndex:
    """Return all codes with one sentence each."""
    faults = tuple((code, _split(MESSAGES[code])[0]) for code in FaultCode)
    return HelpIndex(tuple(PROBLEM_HELP.items()), faults)


def find_problem(code: str) -> ProblemCode | None:
    """Return the problem code of this name."""
    return next((known for known in ProblemCode if known.value == code), None)


def find_fault(code: str) -> FaultHelp | None:
    """Return the help of the fault of this name."""
    return next((fault_help(known) for known in FaultCode if known.value == code), None)


@cache
def fault_help(code: FaultCode) -> FaultHelp:
    """Return the help of a fault; the checker reports a file that is broken in just this way."""
    group = next(group for group in report_of(code).faults if group.code is code)
    happened, remedy = _split(MESSAGES[code])
    return FaultHelp(code, code.value.replace("_", " ").capitalize(), happened, remedy, group)


def _split(message: str) -> tuple[str, str]:
    """Part a message into what is wrong and what to do."""
    happened, colon, remedy = message.partition(": ")
    if not colon:
        return message, ""
    return f"{happened}.", remedy[:1].upper() + remedy[1:]
