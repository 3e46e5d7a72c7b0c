"""Routes of the pages that explain: protocols, help, API."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_schemas.faults import MESSAGES, FaultCode, FaultGroup
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.publish.broken_files import report_of
from exceptiondrive_server.web.problem_help import PROBLEM_HELP, Help
from exceptiondrive_server.web.responses import origin_of, page, problem_page

# The API in one table, from the application's own description.


METHODS = ("get", "post", "put", "patch", "delete")


@dataclass(frozen=True)
class Operation:
    """One operation of the API."""

    method: str
    path: str
    words: str
    needs_token: bool


@dataclass(frozen=True)
class OperationGroup:
    """Operations of one subject."""

    title: str
    operations: tuple[Operation, ...]


def operation_groups(openapi: Mapping[str, Any]) -> tuple[OperationGroup, ...]:
    """Return the operations by tag, in the order of the description."""
    groups: dict[str, list[Operation]] = {}
    for path, item in openapi.get("paths", {}).items():
        for method in METHODS:
            if method not in item:
                continue
            operation = item[method]
            words = operation.get("description") or operation.get("summary", "")
            tag = (operation.get("tags") or ["other"])[0]
            groups.setdefault(tag, []).append(
                Operation(
                    method.upper(), path, words.split("\n")[0], bool(operation.get("security"))
                )
            )
    return tuple(
        OperationGroup(tag.replace("_", " ").capitalize(), tuple(operations))
        for tag, operations in groups.items()
    )


# Help pages: every problem of the API and every fault of a file, with a real report.


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


router = APIRouter(include_in_schema=False)


@router.get("/problems")
def show_problems(request: Request) -> Response:
    """List every code."""
    return page(request, "guide/problems.html", "", page=help_index())


@router.get("/problems/{code}")
def show_problem(request: Request, code: str) -> Response:
    """Explain a problem of the API or a fault of a file."""
    problem, fault = find_problem(code), find_fault(code)
    if problem is not None:
        index = help_index() if problem is ProblemCode.FILE_INVALID else None
        help_ = PROBLEM_HELP[problem]
        return page(request, "guide/problem.html", "", code=problem, help=help_, index=index)
    if fault is not None:
        return page(request, "guide/fault.html", "", fault=fault)
    return problem_page(request, 404, ProblemCode.NOT_FOUND, "There is no problem of this name.")


@router.get("/api")
def show_api(request: Request) -> Response:
    """Show the API in one table."""
    groups = operation_groups(request.app.openapi())
    return page(request, "guide/api.html", "api", groups=groups, server=origin_of(request))
