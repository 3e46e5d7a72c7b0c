"""Which board is asked for: of a phase, under a protocol, of a date; else the current one."""

from datetime import UTC, date, datetime, time
from typing import Annotated

from fastapi import Depends, Query
from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.boards import board_at, current_board, late_board, latest_public_board
from exceptiondrive_records.errors import InvalidRecord, NotFound
from exceptiondrive_records.phases import find_phase, list_phases
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.tables import BoardRow, Phase
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.datetimes import Moment
from exceptiondrive_schemas.phase_settings import BoardView

SORTS = tuple(
    f"{sign}{key}"
    for sign in ("", "-")
    for challenge in CHALLENGES.values()
    for key in challenge.metric_keys
)


class BoardChoice(BaseModel):
    """The query of a board."""

    challenge: ChallengeId | None
    phase: str | None
    protocol: str | None
    as_of: datetime | date | None
    sort: str | None
    view: BoardView = "main"


def board_choice(
    challenge: ChallengeId | None = None,
    phase: Annotated[
        str | None, Query(max_length=64, description="id; else the challenge's first phase")
    ] = None,
    protocol: Annotated[
        str | None, Query(max_length=100, description="version or digest; else the one in force")
    ] = None,
    as_of: Annotated[
        Moment | None,
        Query(description="the board that was current then; of a date, at its end (UTC)"),
    ] = None,
    sort: Annotated[
        str | None,
        Query(
            max_length=64,
            description="metric key, `-` in front for descending; ranks stay, and entries "
            "without a value come last. One of: " + ", ".join(SORTS),
            examples=["ur", "-hcc"],
        ),
    ] = None,
    view: Annotated[
        BoardView,
        Query(
            description="`late`: with the entries that came after the deadline, ranked among all"
        ),
    ] = "main",
) -> BoardChoice:
    """Read the query."""
    return BoardChoice(
        challenge=challenge, phase=phase, protocol=protocol, as_of=as_of, sort=sort, view=view
    )


ChosenBoard = Annotated[BoardChoice, Depends(board_choice)]


def find_chosen(session: Session, choice: BoardChoice) -> BoardRow:
    """Return the board that is asked for.

    Raises:
        NotFound: There is none.
        InvalidRecord: Both a date and a protocol are asked for, or an earlier late view.
    """
    phase = _phase(session, choice)
    if choice.view == "late":
        return _late(session, phase, choice)
    if choice.as_of is not None and choice.protocol is not None:
        raise InvalidRecord("Ask for a date or for a protocol, not for both: a date has its own.")
    if choice.as_of is not None:
        row = board_at(session, phase.id, _moment(choice.as_of))
        if row is None and current_board(session, phase.id) is not None:
            raise NotFound("board that old of the phase", phase.id)
    elif choice.protocol is not None:
        row = latest_public_board(session, phase.id, find_protocol(session, choice.protocol).digest)
    else:
        row = current_board(session, phase.id)
    if row is None:
        raise NotFound("such board of the phase", phase.id)
    return row


def _late(session: Session, phase: Phase, choice: BoardChoice) -> BoardRow:
    if choice.as_of is not None or choice.protocol is not None:
        raise InvalidRecord(
            "The late view is the present one: ask for it without date or protocol."
        )
    row = late_board(session, phase.id)
    if row is None:
        raise NotFound("late view, since nothing came late, of the phase", phase.id)
    return row


def _phase(session: Session, choice: BoardChoice) -> Phase:
    challenge = choice.challenge.value if choice.challenge else None
    if choice.phase is not None:
        phase = find_phase(session, choice.phase)
        if challenge is not None and phase.challenge != challenge:
            raise NotFound(f"phase of the {challenge} challenge", choice.phase)
        return phase
    phases = list_phases(session, challenge)
    if not phases:
        raise NotFound("phase of the challenge", challenge or "any")
    return phases[0]


def _moment(as_of: datetime | date) -> datetime:
    return as_of if isinstance(as_of, datetime) else datetime.combine(as_of, time.max, UTC)
