"""Select public revisions of a split: those that a phase uses or a published board used.

A revision registered for a run in preparation is not public.
"""

from collections.abc import Iterable
from contextlib import suppress

from sqlalchemy import select, union
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.splits import find_split, whole_split
from exceptiondrive_records.splits.tables import SplitRow


def shown_revisions(session: Session, name: str) -> list[SplitRow]:
    """Return the whole revisions that readers know of: those in force first, then newest first.

    For a known part this is the first revision that has it; later ones are known by other changes.

    Raises:
        NotFound: No phase that readers may see uses a split of this name.
    """
    is_of_a_shown_phase = Phase.split_name == name, Phase.visibility != "hidden"
    in_force = select(Phase.split_revision).where(*is_of_a_shown_phase)
    ever = (
        select(BoardRow.split_revision)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .join(Phase, Phase.id == BoardRow.phase_id)
        .where(*is_of_a_shown_phase)
    )
    known = set(session.scalars(union(in_force, ever)))
    now = set(session.scalars(in_force))
    wholes = session.scalars(
        select(SplitRow)
        .where(SplitRow.name == name, SplitRow.part.is_(None))
        .order_by(SplitRow.registered_at.desc())
    ).all()
    first = _last_with(wholes)
    known_wholes = {first.get(revision) for revision in known}
    shown = [row for row in wholes if row.revision in known_wholes]
    if not shown:
        raise NotFound("split", name)
    newest = _last_with(reversed(shown))
    stands = {newest.get(revision) for revision in now}
    return sorted(shown, key=lambda row: row.revision not in stands)


def _last_with(wholes: Iterable[SplitRow]) -> dict[str | None, str]:
    """Map each revision, whole or part, to the last of these whole revisions that contains it."""
    return {
        each: row.revision
        for row in wholes
        for each in (row.revision, row.public_revision, row.private_revision)
    }


def shown_whole(session: Session, phase: Phase) -> SplitRow:
    """Return the whole split of a phase that readers know; if they know none, the newest one."""
    split = session.get_one(SplitRow, (phase.split_name, phase.split_revision))
    if split.part is None:
        return split
    with suppress(NotFound):
        for row in shown_revisions(session, split.name):
            if split.revision in (row.public_revision, row.private_revision):
                return row
    return whole_split(session, split.name, split.revision)


def shown_revision(session: Session, name: str, revision: str | None) -> SplitRow:
    """Return a public revision, by default the one in force.

    Raises:
        NotFound: There is none, or readers do not know of it.
    """
    for row in shown_revisions(session, name):
        if revision is None or row.revision == revision:
            return row
    raise NotFound(f"revision of split {name!r} like", str(revision))


def shown_file(session: Session, name: str, revision: str | None) -> SplitRow:
    """Return the public revision whose file is requested, by default the one in force.

    If no phase uses the split, the default is the one registered last.

    Raises:
        NotFound: There is none, readers do not know of it, or it is withheld.
    """
    is_used = session.scalars(select(Phase.id).where(Phase.split_name == name).limit(1)).first()
    if is_used is not None:
        row = shown_revision(session, name, revision)
        if row.public_file_digest is None:
            raise NotFound("file of split", name, ", which is withheld")
        return row
    with suppress(NotFound):
        row = find_split(session, name, revision)
        if row.public_file_digest is not None:
            return row
    raise NotFound("split", name)  # the same words as for a split of hidden phases only


def is_kept_back(session: Session, name: str) -> bool:
    """Whether a split is used by hidden phases only."""
    using = select(Phase.visibility).where(Phase.split_name == name).distinct()
    return list(session.scalars(using)) == ["hidden"]


def splits_under(session: Session, protocol_digest: str) -> list[str]:
    """Return the names of the splits whose phases use a protocol, sorted."""
    stands = Phase.protocol_digest == protocol_digest, Phase.visibility != "hidden"
    query = select(Phase.split_name).where(*stands).distinct()
    return sorted(session.scalars(query))
