"""Teams and their tokens: list, create, approve or refuse, each on a page of its own."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response

from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.tokens import (
    MEANING_OF_SCOPE,
    TEAM_SCOPES,
    find_token,
    is_live,
    issue_token,
    list_tokens,
    live_tokens_by_team,
    revoke_token,
)
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.participation.changes import MAX_AFFILIATION, approve_team
from exceptiondrive_records.participation.importing import make_team
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.submissions.submissions import counts_by_team
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams, refuse_team
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.accounts.queries import scopes_field, token_views
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.participation.queries import participation_of, standings_of_teams
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import PostedForm, SignedIn
from exceptiondrive_server.web.forms import REASON, filled_fields, posted_texts, read_form
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    has_text,
    organizer_page,
    step_at,
)
from exceptiondrive_server.web.path_ids import TeamId

NEW_TEAM = (
    FormField("id", "Id", hint="lower-case letters, digits, hyphens; cannot be changed later", is_required=True,
          max_length=64),
    FormField("name", "Name", hint="as the board shows it", is_required=True, max_length=80),
    FormField("affiliation", "Affiliation", hint="for organizers", max_length=MAX_AFFILIATION),
    FormField("email", "E-mail", hint="for notices, once its owner confirms it",
              max_length=400),
    FormField("is_reference", "A reference row", "yes", "shown on the board, never ranked"),
)  # fmt: skip
NEW_TOKEN = (
    FormField("name", "Name", hint="what it is for", is_required=True, max_length=80),
    scopes_field(TEAM_SCOPES),
    FormField("expires_at", "Expires at", "moment", "empty: never"),
)
USUAL = {"scopes": " ".join(TEAM_SCOPES)}
"""The first token of a team has every right that a team may have."""
HISTORY = 50
router = APIRouter(prefix="/organize", include_in_schema=False)
TokenId = Annotated[str, Path(max_length=64)]


@router.get("/teams")
def show_teams(
    browser: OrganizerBrowser,
    show: Annotated[str, Query(max_length=20)] = "",
    q: Annotated[str, Query(max_length=80)] = "",
) -> Response:
    """List the teams, or those with a text; those that wait for approval come first."""
    return _list(browser, only_pending=show == "pending", find=q)


@router.post("/teams")
def post_team(browser: OrganizerBrowser, form: PostedForm) -> Response:
    """Make a team."""
    try:
        values = read_form(NEW_TEAM, form)
        with browser.services.database.write() as session:
            slug = values.pop("id")
            make_team(session, slug, **values, actor=browser.principal.actor)
    except RecordsError as refusal:
        return _list(browser, texts=posted_texts(form), refusal=refusal)
    return go(f"/organize/teams/{slug}", "team_created")


@router.get("/teams/{team_id}")
def show_team(browser: OrganizerBrowser, team_id: TeamId) -> Response:
    """Show a team and its tokens."""
    return _team(browser, team_id)


@router.post("/teams/{team_id}/tokens")
def post_token(browser: OrganizerBrowser, form: PostedForm, team_id: TeamId) -> Response:
    """Issue a token for a team, and show its text this once."""
    try:
        values = read_form(NEW_TOKEN, form)
        with browser.services.database.write() as session:
            text, _ = issue_token(
                session,
                find_team(session, team_id).id,
                values["name"],
                values["scopes"],
                values["expires_at"],
                actor=browser.principal.actor,
            )
    except RecordsError as refusal:
        return _team(browser, team_id, texts=posted_texts(form), refusal=refusal)
    return _team(browser, team_id, issued=text)


def _list(
    browser: SignedIn,
    *,
    only_pending: bool = False,
    find: str = "",
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    with browser.services.database.read() as session:
        standings = standings_of_teams(session)
        by_id = {one.id: one for one in list_teams(session)}
        teams = [
            one
            for one in by_id.values()
            if (one.pending_since or not only_pending)
            and has_text(find, one.slug, one.name, one.affiliation)
        ]
        n_tokens, n_submissions = live_tokens_by_team(session), counts_by_team(session)
    return organizer_page(
        browser,
        "teams/organizer_teams.html",
        "teams",
        refusal=refusal,
        teams=sorted(teams, key=lambda team: team.pending_since is None),
        by_id=by_id,
        standings=standings,
        n_tokens=n_tokens,
        n_submissions=n_submissions,
        only_pending=only_pending,
        find=find,
        n_all=len(by_id),
        fields=filled_fields(NEW_TEAM, texts or {}),
    )


def _team(
    browser: SignedIn,
    slug: str,
    *,
    issued: str | None = None,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    """Show a team; `issued` is the text of a new token, shown this once."""
    with browser.services.database.read() as session:
        team = find_team(session, slug)
        now = database_now(session)
        tokens = list_tokens(session, team.id)
        views = token_views(session, tokens, team.id)
        is_alive = [is_live(token, now) for token in tokens]
        lines = history(session, team.slug, limit=HISTORY + 1)
        n_submissions = counts_by_team(session).get(team.id, 0)
        seen = participation_of(session, team)
        phases = list_phases(session, with_hidden=True)
        part_of = session.get(Team, team.merged_into_id) if team.merged_into_id else None
    return organizer_page(
        browser,
        "teams/organizer_team.html",
        "teams",
        refusal=refusal,
        team=team,
        part_of=part_of,
        tokens=sorted(zip(views, is_alive, strict=True), key=lambda line: not line[1]),
        meaning=MEANING_OF_SCOPE,
        new_token=issued,
        lines=lines[:HISTORY],
        has_older_lines=len(lines) > HISTORY,
        n_submissions=n_submissions,
        seen=seen,
        phases=phases,
        titles={phase.id: phase.title for phase in phases},
        fields=filled_fields(NEW_TOKEN, USUAL if texts is None else texts),
    )


@step_at(router, "/teams/{team_id}/approve")
def approval(services: ServicesOf, team_id: TeamId) -> Step:
    """Let a team that registered itself submit."""
    with services.database.read() as session:
        team = find_team(session, team_id)
    return _registration(
        team,
        title=f"Approve {team.name}",
        meaning="The team can submit from now on; its inbox says so.",
        button="Approve",
        command=f"exceptiondrive organizer teams approve {team.slug}",
        take=partial(approve_team, slug=team_id),
        done="team_approved",
    )


@step_at(router, "/teams/{team_id}/refuse")
def refusal_of(services: ServicesOf, team_id: TeamId) -> Step:
    """Refuse a registration."""
    with services.database.read() as session:
        team = find_team(session, team_id)
    return _registration(
        team,
        title=f"Refuse {team.name}",
        meaning="The team and its tokens are removed; its id and name are free again. The reason "
        "stays in the audit log. Members who sign in see that it was refused, but not why: write to "
        "them if you want to.",
        button="Refuse",
        fields=(REASON,),
        command=f'exceptiondrive organizer teams refuse {team.slug} --reason "…"',
        is_grave=True,
        take=partial(refuse_team, slug=team_id),
        done="team_refused",
        onward=lambda _: "/organize/teams",
    )


def _registration(team: Team, **words: Any) -> Step:
    return Step(
        section="teams",
        back=f"/organize/teams/{team.slug}",
        back_words="The team",
        facts=(("Id", team.slug), ("Their note", team.registration_note or "nothing")),
        **words,
    )


@step_at(router, "/tokens/{token_id}/revoke")
def revocation(services: ServicesOf, token_id: TokenId) -> Step:
    """Revoke a token for good."""
    with services.database.read() as session:
        token = find_token(session, token_id)
        team = None if token.team_id is None else session.get(Team, token.team_id)
        (seen,) = token_views(session, [token], token.team_id)
        left = left_behind(session, f"token:{token.id}", token.team_id)
        made = [f"{one.name} ({one.prefix})" for one in left]
    works_on = " Tokens made with it keep working: revoke these too, if they are not wanted."
    return Step(
        section="teams",
        title=f"Revoke {token.name}",
        meaning="It stops working for good; browsers that signed in with it are signed out."
        f"{works_on if made else ''}",
        button="Revoke",
        back="/organize/teams" if team is None else f"/organize/teams/{team.slug}",
        back_words="Teams" if team is None else "The team",
        facts=(
            ("Begins with", token.prefix),
            ("Team", "none: an organizer's" if team is None else team.name),
            ("Scopes", ", ".join(token.scopes)),
            ("Made by", seen.made_by),
            *([("Tokens made with it", ", ".join(made))] if made else ()),
        ),
        command=f"exceptiondrive organizer teams revoke-token {token.id}",
        is_grave=True,
        take=partial(revoke_token, token_id=token_id),
        done="token_revoked",
    )
