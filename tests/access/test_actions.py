"""Every action of organizers: by page, by command and by API, audited, and safe under two at once."""

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from tests.access.test_roles import organizer_routes

from exceptiondrive.cli.organizer.commands import GROUPS
from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token
from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.news.questions import ask_question
from exceptiondrive_records.teams.teams import find_team, register_team

if TYPE_CHECKING:
    from tests.support.application import Api

WHY = {"reason": "as announced"}
ROWS = "method,hcc,split,split_revision,protocol\nFar,0.2,far,sha256:" + "a" * 64 + ",1.0\n"
API_ALONE = ""


class Action(NamedTuple):
    """How one action is done."""

    page: str
    """Path of its page below /organize; empty: by API alone."""
    command: str
    """After `exceptiondrive organizer`; empty: by API alone."""
    undone_by: str | None
    """Path below /organizer of what takes it back; None: it stays, which its page says."""
    audit_line: str = ""
    """What the audit log calls it, where it is tried here."""
    body: Any = WHY
    twice: tuple[int, int] = (409, 409)
    """How the later of two at once is answered: a status from this to that."""


SUBMISSION = "/submissions/{submission_id}"
TEAM = "/teams/{team_id}"
PHASE = "/phases/{phase_id}"
RUN = "/rescoring/{run_id}"
REPORTED = f"{PHASE}/reported"
NONE = (200, 299)
"""Both are done, and say the same: each leaves its line."""
ACTIONS = {
    # teams
    ("POST", "/teams"): Action(
        "/teams", "teams create", f"{TEAM}/forget", "team created", {"id": "new", "name": "New"}
    ),
    ("POST", "/team-imports"): Action(
        *("/teams/import", "teams import", f"{TEAM}/forget", "team created"),
        {"csv": "id,name\nnew,New\n"},
        (400, 409),
    ),
    ("PATCH", TEAM): Action(
        f"{TEAM}/change", "teams change", TEAM, "team changed", {**WHY, "name": "Other"}, NONE
    ),
    ("POST", f"{TEAM}/approve"): Action(
        f"{TEAM}/approve", "teams approve", f"{TEAM}/disqualify", "team approved", WHY, NONE
    ),
    ("POST", f"{TEAM}/refuse"): Action(
        f"{TEAM}/refuse", "teams refuse", None, "team refused", WHY, (404, 404)
    ),
    ("POST", f"{TEAM}/merge"): Action(
        f"{TEAM}/merge", "teams merge", None, "team merged", {**WHY, "into": "beta"}
    ),
    ("POST", f"{TEAM}/forget"): Action(
        f"{TEAM}/forget", "teams forget", None, "team forgotten", WHY, (404, 409)
    ),
    ("POST", f"{TEAM}/disqualify"): Action(
        *(f"{TEAM}/disqualify", "teams disqualify"),
        *("/disqualifications/{disqualification_id}/reinstate", "team disqualified"),
    ),
    ("POST", f"{SUBMISSION}/disqualify"): Action(
        *(f"{SUBMISSION}/disqualify", "submissions disqualify"),
        *("/disqualifications/{disqualification_id}/reinstate", "submission disqualified"),
    ),
    ("POST", "/disqualifications/{disqualification_id}/reinstate"): Action(
        *("/disqualifications/{disqualification_id}/reinstate", "teams reinstate"),
        *(f"{TEAM}/disqualify", "team reinstated"),
    ),
    ("PATCH", f"{TEAM}/allowances/{{phase_id}}"): Action(
        *(f"{TEAM}/allowances/{{phase_id}}", "teams limits", f"{TEAM}/allowances/{{phase_id}}"),
        "allowance changed",
        {**WHY, "quota_total": 2},
        (200, 409),
    ),
    ("POST", "/messages"): Action(
        "/messages", "message", None, "message sent", {"title": "A", "text": "B"}
    ),
    ("POST", f"{TEAM}/tokens"): Action(
        *(f"{TEAM}/tokens", "teams issue-token", "/tokens/{token_id}/revoke", "token issued"),
        {"name": "laptop"},
        NONE,
    ),
    ("POST", "/tokens/{token_id}/revoke"): Action(
        "/tokens/{token_id}/revoke", "teams revoke-token", None, "token revoked", None, (200, 409)
    ),
    ("POST", f"{TEAM}/invitations"): Action(API_ALONE, API_ALONE, None),
    ("POST", "/people/{person_id}/organizer"): Action(
        "/people/{person_id}", "people set", "/people/{person_id}/organizer"
    ),
    ("POST", "/people/{person_id}/forget"): Action(
        *("/people/{person_id}/forget", "people forget", None, "person forgotten"), WHY, (404, 404)
    ),
    # submissions
    ("POST", f"{SUBMISSION}/retry"): Action(
        f"{SUBMISSION}/{{action}}", "submissions retry", None, "scoring retried by hand"
    ),
    ("POST", f"{SUBMISSION}/verify"): Action(
        f"{SUBMISSION}/{{action}}",
        "submissions verify",
        None,
        "verification started",
        WHY,
        (202, 409),
    ),
    ("POST", f"{SUBMISSION}/restore"): Action(
        f"{SUBMISSION}/{{action}}", "submissions restore", None, "submission restored"
    ),
    ("POST", f"{SUBMISSION}/note"): Action(
        f"{SUBMISSION}/{{action}}", "submissions note", None, "team told", {"words": "We look."}
    ),
    # the challenge
    ("POST", f"{PHASE}/news"): Action(
        *(f"{PHASE}/news", "news publish", "/news/{news_id}/withdraw", "news published"),
        {"title": "A", "text": "B"},
    ),
    ("POST", "/news/{news_id}/withdraw"): Action(
        "/news/{news_id}/withdraw", "news withdraw", f"{PHASE}/news", "news withdrawn"
    ),
    ("POST", "/questions/{question_id}/answer"): Action(
        *("/news/questions/{question_id}", "questions answer", None, "question answered"),
        {"text": "Yes."},
    ),
    ("POST", REPORTED): Action(
        *(f"{REPORTED}/new", "phases import-reported", f"{REPORTED}/{{reported_id}}/withdraw"),
        "reported board imported",
        {"title": "A", "cite": "B", "file": ROWS},
    ),
    ("POST", f"{REPORTED}/{{reported_id}}/withdraw"): Action(
        *(f"{REPORTED}/{{reported_id}}/withdraw", "phases withdraw-reported", REPORTED),
        "reported board withdrawn",
    ),
    ("POST", "/phases"): Action("/phases/new", "phases create", f"{PHASE}/delete"),
    ("PATCH", PHASE): Action(PHASE, "phases update", PHASE),
    ("POST", f"{PHASE}/feature"): Action(f"{PHASE}/{{step}}", "phases feature", PHASE),
    ("POST", f"{PHASE}/delete"): Action(f"{PHASE}/{{step}}", "phases delete", None),
    ("POST", f"{PHASE}/freeze"): Action(
        f"{PHASE}/{{step}}", "phases freeze", f"{PHASE}/reveal", "board frozen"
    ),
    ("POST", f"{PHASE}/reveal"): Action(f"{PHASE}/{{step}}", "phases reveal", None),
    ("PATCH", "/site"): Action("/site", "site set", "/site"),
    # protocols and rescoring: tests/rescoring tries two at once
    ("POST", "/protocols"): Action(
        "/protocols/new", "protocols add", "/protocols/{version}/delete"
    ),
    ("POST", "/protocols/{version}/delete"): Action(
        "/protocols/{version}/delete", "protocols delete", "/protocols"
    ),
    ("POST", "/confirmations"): Action(
        *("/protocols/confirm", "protocols confirm"), "/confirmations/{confirmation_id}/withdraw"
    ),
    ("POST", "/confirmations/{confirmation_id}/withdraw"): Action(
        *("/protocols/confirmations/{confirmation_id}/withdraw", "protocols withdraw-confirmation"),
        "/confirmations",
    ),
    ("POST", "/rescoring"): Action("/rescoring/new", "rescore start", f"{RUN}/cancel"),
    ("POST", "/rescoring/verifications"): Action("/verifications/new", "rescore verify", None),
    ("POST", f"{RUN}/start"): Action(f"{RUN}/{{step}}", "rescore begin", f"{RUN}/cancel"),
    ("POST", f"{RUN}/pause"): Action(f"{RUN}/{{step}}", "rescore pause", f"{RUN}/resume"),
    ("POST", f"{RUN}/resume"): Action(f"{RUN}/{{step}}", "rescore resume", f"{RUN}/pause"),
    ("POST", f"{RUN}/cancel"): Action(f"{RUN}/{{step}}", "rescore cancel", None),
    ("POST", f"{RUN}/apply"): Action(f"{RUN}/{{step}}", "rescore apply", f"{RUN}/rollback"),
    ("POST", f"{RUN}/rollback"): Action(f"{RUN}/{{step}}", "rescore rollback", None),
    ("POST", f"{RUN}/close"): Action(f"{RUN}/{{step}}", "rescore close", None),
}
READS = {("POST", "/protocols/check")}
TRIED = {key: action for key, action in ACTIONS.items() if action.audit_line}


def routes(below: str) -> set[tuple[str, str]]:
    """What changes something, by its path below one of the two roots."""
    return {
        (method, path.removeprefix(below))
        for method, path in organizer_routes()
        if path.startswith(f"{below}/") and method not in ("GET", "HEAD")
    }


def test_every_route_that_changes_something_is_an_action_of_the_table() -> None:
    assert routes("/api/v1/organizer") - READS == set(ACTIONS)


def test_every_action_has_its_page_and_its_command() -> None:
    pages = {path for _, path in routes("/organize")}
    commands = {f"{group} {name}" for group, (_, named) in GROUPS.items() for name in named}
    assert {action.page for action in ACTIONS.values()} - {API_ALONE} == pages
    assert {action.command for action in ACTIONS.values()} - commands == {"message", API_ALONE}
    assert [
        key for key, action in ACTIONS.items() if bool(action.page) != bool(action.command)
    ] == []


def test_what_takes_an_action_back_is_an_action() -> None:
    known = {path for _, path in ACTIONS}
    assert [action for action in ACTIONS.values() if action.undone_by not in (None, *known)] == []


def test_what_the_document_advises_after_a_mistake_are_commands() -> None:
    text = (Path(__file__).parents[2] / "docs" / "organizing.md").read_text()
    _, _, after = text.partition("## When something went wrong\n")
    table = after.partition("\n## ")[0]
    advised = {tuple(words[:2]) for quoted in re.findall(r"`([a-z][^`]*)`", table)
               if (words := quoted.split())[0] in GROUPS and len(words) > 1}  # fmt: skip
    assert len(advised) > 10
    known = {(group, name) for group, (_, named) in GROUPS.items() for name in named}
    assert advised - known == set()


def fresh(api: "Api") -> dict[str, str]:
    """A site on which each action can be done once; the ids of its parts."""
    scored = api.submit("a").json()["id"]
    api.score(scored)
    with api.database.write() as session:
        register_team(session, "pending", "Pending Team", "We are new.")
        beta = find_team(session, "beta").id
        _, token = issue_token(session, beta, "old", TEAM_SCOPES, actor="test")
        question = ask_question(session, beta, "dev", "May we?", actor="test").id
        token_id = token.id
        person = welcome_person(session, Identity("https://id.example.org", "ada")).id
    return {
        "team_id": "alpha",
        "phase_id": "dev",
        "submission_id": scored,
        "token_id": str(token_id),
        "question_id": question,
        "person_id": person,
    }


def prepared(api: "Api", method: str, path: str) -> dict[str, str]:
    """The ids of a path, of parts that are as the action needs them."""
    ids = fresh(api)
    done = {"json": WHY}
    match path.rsplit("/", 1)[1]:
        case "approve" | "refuse":
            ids["team_id"] = "pending"
        case "reinstate":
            made = api.post("/organizer/teams/alpha/disqualify", "organizer", **done).json()
            ids["disqualification_id"] = str(made["id"])
        case "retry":
            ids["submission_id"] = api.submit("b").json()["id"]
            api.fail(ids["submission_id"])
        case "restore":
            api.post(f"/submissions/{ids['submission_id']}/withdraw", "alpha")
        case "withdraw" if "news" in path:
            body = {"title": "A", "text": "B"}
            made = api.post("/organizer/phases/dev/news", "organizer", json=body).json()
            ids["news_id"] = made["id"]
        case "withdraw":
            body = {"title": "A", "cite": "B", "file": ROWS}
            made = api.post("/organizer/phases/dev/reported", "organizer", json=body).json()
            ids["reported_id"] = made["id"]
    return ids


@pytest.mark.parametrize("key", TRIED, ids=lambda key: " ".join(key))
def test_of_two_organizers_at_once_each_is_done_or_refused_and_audited(
    api_on_both: "Api", key: tuple[str, str]
) -> None:
    api, action, (method, path) = api_on_both, TRIED[key], key
    asked = path.format(**prepared(api, method, path))
    with api.database.read() as session:
        before = audit_page(session, action=action.audit_line)
    more = {} if action.body is None else {"json": action.body}

    def send(_: int) -> Any:
        return api.request(method, f"/organizer{asked}", "organizer", **more)

    with ThreadPoolExecutor(2) as both:
        first, second = sorted(both.map(send, range(2)), key=lambda answer: answer.status_code)
    assert first.status_code < 300, first.text
    assert action.twice[0] <= second.status_code <= action.twice[1], second.text
    with api.database.read() as session:
        lines = audit_page(session, action=action.audit_line)[: -len(before) or None]
    n_done = sum(answer.status_code < 300 for answer in (first, second))
    assert (
        1 <= len(lines) <= n_done * (2 if action.audit_line == "team merged" else 1)
    )  # one of each team
    assert all(line.actor.startswith("token:") for line in lines)
