"""Settings of the server: those of the records, and what only the server needs."""

import ipaddress
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, field_validator, model_validator

from exceptiondrive_records.db.settings import RecordsSettings, SiteUrl
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES, MAX_UPLOAD_BYTES

LOOPBACK = ("127.0.0.1", "::1", "localhost")


def is_private_url(url: str) -> bool:
    """Whether nobody on the way can read along: https, or this very machine."""
    parts = urlsplit(url)
    return parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in LOOPBACK)


class ServerSettings(RecordsSettings):
    """Environment variables with the prefix `EXCEPTIONDRIVE_`."""

    public_url: SiteUrl = ""
    """What people type; by default what each request names. `https://` makes cookies Secure."""
    self_registration: bool | None = None
    """False forces self-registration off; True has it on until the operator's command switches it; by
    default it is off until then."""
    trusted_proxies: str = "127.0.0.1"
    """Addresses or networks, with commas, whose `X-Forwarded-For` names the sender."""
    oidc_issuer: str = ""
    """Address of the OpenID provider through which people sign in; by default there is none."""
    oidc_client_id: str = ""
    oidc_client_secret: SecretStr = SecretStr("")
    oidc_name: Annotated[str, Field(max_length=40)] = "single sign-on"
    """How the button of the sign-in page calls the provider."""
    max_upload_bytes: Annotated[int, Field(ge=1024, le=MAX_INFLATED_BYTES)] = MAX_UPLOAD_BYTES
    uploads_at_once: Annotated[int, Field(ge=1, le=10_000)] = 32
    """Uploads that one process takes at a time; more are told to come again (503)."""
    uploads_at_once_per_team: Annotated[int, Field(ge=1, le=10_000)] = 4
    """Of these, uploads of one team, and one once half of all are taken; more are told to come again
    (429), before a byte is read."""
    receipt_key_file: Path = Path("data/receipt-key.pem")
    """Private key that signs receipts; made (0600) when it is needed and not there."""
    client_dir: Path | None = None
    """Folder with the client's wheel, and those of its dependencies for closed networks; by default the
    site offers no client."""
    board_max_age_s: Annotated[int, Field(ge=0, le=3600)] = 10
    """How long a cache may serve a board without asking again."""
    events_every_s: Annotated[float, Field(gt=0, le=60)] = 0.5
    """How often a followed submission is polled."""
    events_longest_s: Annotated[float, Field(gt=0, le=3600)] = 300.0
    """After this a follower connects again."""

    @field_validator("trusted_proxies")
    @classmethod
    def _proxies_are_addresses(cls, proxies: str) -> str:
        """Uvicorn takes whatever it cannot read for a name, and then believes no proxy at all."""
        for proxy in proxies.split(",") if proxies else ():  # nobody is believed where it is empty
            try:
                ipaddress.ip_network(proxy.strip())
            except ValueError:
                raise ValueError(
                    f"{proxy.strip()!r} is no address and no network; write them with commas, as in "
                    "127.0.0.1,172.30.250.0/24, a network by its first address"
                ) from None
        return proxies

    @model_validator(mode="after")
    def _provider_is_complete(self) -> "ServerSettings":
        if self.oidc_issuer and not is_private_url(self.oidc_issuer):
            raise ValueError("EXCEPTIONDRIVE_OIDC_ISSUER must start with https://")
        if self.oidc_issuer and not (self.oidc_client_id and self.public_url):
            raise ValueError(
                "EXCEPTIONDRIVE_OIDC_ISSUER needs EXCEPTIONDRIVE_OIDC_CLIENT_ID, and "
                "EXCEPTIONDRIVE_PUBLIC_URL for the address that the provider sends people back to"
            )
        return self
