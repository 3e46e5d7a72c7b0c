"""Protocol documents: added once, never changed."""

from functools import lru_cache

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import flush_or_refuse
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.splits.tables import SplitOpening
from exceptiondrive_schemas.protocol import (
    NEWEST,
    NEWEST_WITHHELD,
    ProtocolDocument,
    ProtocolError,
    packaged_digests,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.protocols.sense import nonsense

_BY_NAME = select(ProtocolRow).where(
    (ProtocolRow.digest == bindparam("name")) | (ProtocolRow.version == bindparam("name"))
)


def add_protocol(session: Session, toml: str, actor: str) -> ProtocolDocument:
    """Add a protocol; adding the same content again does nothing.

    Raises:
        InvalidRecord: Not a valid protocol document.
        Conflict: The version is taken by another content.
    """
    protocol = checked_protocol(session, toml)
    if session.get(ProtocolRow, protocol.digest) is not None:
        return protocol
    session.add(
        ProtocolRow(
            digest=protocol.digest,
            version=protocol.version,
            toml=toml,
            created_at=database_now(session),
        )
    )
    session.flush()
    audit(session, actor, "protocol added", protocol.version, {"digest": protocol.digest})
    return protocol


def delete_protocol(
    session: Session, version_or_digest: str, *, reason: str, actor: str
) -> ProtocolDocument:
    """Delete a protocol that was never used; its version may be reused.

    Raises:
        NotFound: There is none.
        InvalidRecord: The reason is empty.
        Conflict: A phase or run uses it, a split was opened under it, or it is packaged.
    """
    row = find_protocol_row(session, version_or_digest)
    protocol = find_protocol(session, row.digest)
    reason = checked_reason(reason)
    users = protocol_users(session).get(row.digest)
    if users:
        raise Conflict(
            f"Protocol {row.version} cannot be deleted: {', '.join(users)} names it, and the records keep "
            "every run, even a cancelled one. A new document needs another version."
        )
    if row.digest in packaged_digests():
        raise Conflict(f"Protocol {row.version} comes with this software and cannot be deleted.")
    session.delete(row)
    flush_or_refuse(session, f"Protocol {protocol.version} is in use and cannot be deleted.")
    detail = {"digest": protocol.digest, "reason": reason}
    audit(session, actor, "protocol deleted", protocol.version, detail)
    return protocol


def protocol_users(session: Session) -> dict[str, list[str]]:
    """Return the users of each protocol, in words: phases, runs, and withheld splits opened under it."""
    phases = session.execute(select(Phase.protocol_digest, Phase.id))
    sides = RescoringRun.from_protocol_digest, RescoringRun.to_protocol_digest
    runs = [row for side in sides for row in session.execute(select(side, RescoringRun.id))]
    named = {(digest, f"phase {key}") for digest, key in phases}
    named |= {(digest, f"rescoring run {key}") for digest, key in runs}
    openings = session.execute(select(SplitOpening.protocol_digest, SplitOpening.split_name))
    named |= {(digest, f"an opening of split {name}") for digest, name in openings}
    users: dict[str, list[str]] = {}
    for digest, words in sorted(named):
        users.setdefault(digest, []).append(words)
    return users


def checked_protocol(session: Session, toml: str) -> ProtocolDocument:
    """Return a valid protocol document, which can be added or is recorded already.

    Raises:
        InvalidRecord: Not a valid protocol document, or one with meaningless values.
        Conflict: The version is taken by another content.
    """
    try:
        protocol = parse_protocol(toml)
    except ProtocolError as error:
        raise InvalidRecord(str(error)) from error
    query = select(ProtocolRow).where(ProtocolRow.version == protocol.version)
    held = session.scalars(query).first()
    if held is not None and held.digest == protocol.digest:
        return protocol
    if meaningless := nonsense(protocol):
        raise InvalidRecord(str(ProtocolError(meaningless)))
    if held is not None:
        raise Conflict(
            f"Protocol {protocol.version} exists with other content. A protocol never changes: "
            "give the new content a new version."
        )
    return protocol


def find_protocol_row(session: Session, version_or_digest: str) -> ProtocolRow:
    """Return the row of a protocol, by version or digest.

    Raises:
        NotFound: There is none.
    """
    row = session.scalars(_BY_NAME, {"name": version_or_digest}).first()
    if row is None:
        raise NotFound("protocol", version_or_digest)
    return row


def find_protocol(session: Session, version_or_digest: str) -> ProtocolDocument:
    """Return a protocol, by version or digest.

    Raises:
        NotFound: There is none.
        Conflict: The recorded text does not match its recorded digest: it was edited in place.
    """
    row = find_protocol_row(session, version_or_digest)
    protocol = _parsed_protocol(row.toml)
    if protocol.digest != row.digest:
        raise Conflict(f"The recorded text of protocol {row.version} was altered; refusing it.")
    return protocol


def list_protocols(session: Session) -> list[ProtocolDocument]:
    """Return all protocols, oldest first."""
    return [find_protocol(session, row.digest) for row in list_protocol_rows(session)]


def list_protocol_rows(session: Session) -> list[ProtocolRow]:
    """Return the rows of all protocols, oldest first."""
    order = (ProtocolRow.created_at, ProtocolRow.digest)
    return list(session.scalars(select(ProtocolRow).order_by(*order)))


@lru_cache(maxsize=32)
def _parsed_protocol(toml: str) -> ProtocolDocument:
    return parse_protocol(toml)


def usual_protocol(session: Session, actor: str, *, is_withheld: bool) -> str:
    """Return the digest of the default protocol of a new phase, adding a packaged one if needed.

    For a withheld split that is the newest packaged one for these; for a public split the newest
    that a phase uses, so that no draft is chosen, or else the last that was added.
    """
    if is_withheld:
        return add_protocol(session, packaged_protocol_toml(NEWEST_WITHHELD), actor).digest
    in_use = set(session.scalars(select(Phase.protocol_digest)))
    known = [row for row in list_protocol_rows(session) if row.version != NEWEST_WITHHELD]
    candidates = [row for row in known if row.digest in in_use] or known
    if candidates:
        return candidates[-1].digest
    return add_protocol(session, packaged_protocol_toml(NEWEST), actor).digest
