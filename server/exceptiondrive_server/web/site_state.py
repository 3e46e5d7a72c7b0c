"""What every page says of the whole site, read at most once a second."""

import time

from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.site import preparing, site_links
from exceptiondrive_records.operations.status import scoring_delay
from exceptiondrive_schemas.site import SiteLinks

CLOCK_S = 1.0


class SiteState:
    """Links, and whether scoring is delayed; while the records are away, what they said last."""

    def __init__(self, database: Database, heartbeat_ttl_s: float) -> None:
        self._database = database
        self._ttl_s = heartbeat_ttl_s
        self._said = (SiteLinks(), "", "")
        self._read_at_s = -CLOCK_S

    def now(self) -> tuple[SiteLinks, str, str]:
        """Return the links; why scoring is delayed, or nothing; what is being made, or nothing."""
        if time.monotonic() - self._read_at_s >= CLOCK_S:
            try:
                with self._database.read() as session:
                    delay = scoring_delay(session, ttl_s=self._ttl_s)
                    self._said = site_links(session), delay, preparing(session)
            except SQLAlchemyError:  # pages that need no records are shown all the same
                pass
            self._read_at_s = time.monotonic()
        return self._said

    def forget(self) -> None:
        """Read anew at the next page."""
        self._read_at_s = -CLOCK_S
