"""Import many teams from a CSV table: all of them, or none."""

import csv
import io
from typing import NamedTuple

from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token
from exceptiondrive_records.db.csv_table import faults_text, named_rows
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, RecordsError
from exceptiondrive_records.db.identifiers import skeleton
from exceptiondrive_records.notifications.contacts import add_contact
from exceptiondrive_records.notifications.tables import Channel
from exceptiondrive_records.participation.changes import checked_affiliation
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team

COLUMNS = ("id", "name", "affiliation", "email")
"""Columns named in the first line; the last two are optional."""
MAX_TEAMS = 500


class ImportedTeam(NamedTuple):
    """A created team, and its first token, which is shown once."""

    slug: str
    name: str
    token: str


def import_teams(session: Session, text: str, *, actor: str) -> list[ImportedTeam]:
    """Create the teams of a table, each with a token, and with its address if it has one.

    An address gets one request for confirmation, and nothing more until its reader confirms it. The
    first line of the CSV names the columns; commas, semicolons or tabs separate them. The caller
    must roll back after a refusal, so that no team is left.

    Raises:
        InvalidRecord: The table cannot be read, or lines are refused: each is named.
    """
    made, faults = list[ImportedTeam](), list[tuple[int, str]]()
    lines: dict[str, int] = {}  # by id, and by skeleton of the name
    rows = named_rows(text, most=MAX_TEAMS)
    if not {"id", "name"} <= rows[0][1].keys() <= set(COLUMNS):
        raise InvalidRecord(
            f"The first line must name columns of {', '.join(COLUMNS)}; id and name are needed."
        )
    for number, values in rows:
        try:
            with session.begin_nested():
                team = _make_team(session, values, actor)
        except Conflict as refusal:  # id and name are valid, so they are short
            earlier = lines.get(values["id"]) or lines.get(_name_key(values["name"]))
            why = f"It has the id or the name of line {earlier}." if earlier else str(refusal)
            faults.append((number, why))
        except RecordsError as refusal:
            faults.append((number, str(refusal)))
        else:
            made.append(team)
            lines |= {team.slug: number, _name_key(team.name): number}
    if faults:
        raise InvalidRecord(f"No team was made. {faults_text(faults)}")
    return made


def _name_key(name: str) -> str:
    """Return the skeleton of a name as a key that differs from all ids."""
    return f"name {skeleton(name)}"


def tokens_table(made: list[ImportedTeam]) -> str:
    """Return the tokens of new teams as CSV, to be handed over and not stored."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("id", "token"))
    writer.writerows((team.slug, team.token) for team in made)
    return out.getvalue()


def make_team(
    session: Session,
    slug: str,
    name: str,
    *,
    affiliation: str = "",
    email: str = "",
    is_reference: bool = False,
    actor: str,
) -> Team:
    """Create a team with the data that organizers have.

    Only organizers see the affiliation. Notices go to the e-mail address after its reader confirms
    it. Entries of a reference team are shown and never ranked. The caller must roll back after a
    refusal.

    Raises:
        InvalidRecord: One of the texts cannot be used.
        Conflict: Id or name is taken.
    """
    affiliation = checked_affiliation(affiliation)
    team = create_team(session, slug, name, is_reference=is_reference, actor=actor)
    team.affiliation = affiliation
    if email:
        add_contact(session, team.id, Channel.EMAIL, email, actor=actor)
    return team


def _make_team(session: Session, values: dict[str, str], actor: str) -> ImportedTeam:
    team = make_team(
        session,
        values["id"],
        values["name"],
        affiliation=values.get("affiliation", ""),
        email=values.get("email", ""),
        actor=actor,
    )
    token, _ = issue_token(session, team.id, "first token", TEAM_SCOPES, actor=actor)
    return ImportedTeam(team.slug, team.name, token)
