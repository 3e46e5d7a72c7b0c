"""Settings of the server: those of the records, and what only the server needs."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from exceptiondrive_records.settings import RecordsSettings

MEBIBYTE = 1024 * 1024


class ServerSettings(RecordsSettings):
    """Environment variables with the prefix `EXCEPTIONDRIVE_`."""

    public_url: Annotated[str, Field(pattern=r"^(https?://[^/?#@\s]+/?)?$")] = ""
    """What people type; by default what each request names. `https://` makes cookies Secure."""
    self_registration: bool = False
    """Whether teams may register themselves; they submit when an organizer has approved them."""
    max_upload_bytes: Annotated[int, Field(ge=1024, le=1024 * MEBIBYTE)] = 16 * MEBIBYTE
    uploads_at_once: Annotated[int, Field(ge=1, le=10_000)] = 32
    """Uploads that one process takes at a time; more are told to come again (503)."""
    receipt_key_file: Path = Path("data/receipt-key.pem")
    """Private key that signs receipts; made (0600) when it is needed and not there."""
    board_max_age_s: Annotated[int, Field(ge=0, le=3600)] = 10
    """How long a cache may serve a board without asking again."""
    events_every_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """How often a followed submission is looked at."""
    webhooks_may_be_private: bool = False
    """Takes webhooks to this very machine, over http: for tests alone."""
    events_longest_s: Annotated[float, Field(gt=0, le=3600)] = 300.0
    """After this a follower connects again."""
