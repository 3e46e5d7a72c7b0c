"""Settings of what is sent outside; only the reconciler's process reads them."""

from typing import Annotated, Literal

from pydantic import Field, SecretStr

from exceptiondrive_records.db.settings import RecordsSettings, Seconds


class NoticeSettings(RecordsSettings):
    """Environment variables with the prefix `EXCEPTIONDRIVE_`."""

    public_url: str = "http://127.0.0.1:8000"
    smtp_host: str | None = None
    """Without one, no e-mail is sent; inbox and webhooks work all the same."""
    smtp_port: Annotated[int, Field(ge=1, le=65535)] = 587
    smtp_security: Literal["starttls", "tls", "none"] = "starttls"
    smtp_user: str | None = None
    smtp_password: SecretStr = SecretStr("")
    mail_from: str = "ExceptionDrive <no-reply@localhost>"
    webhooks_may_be_private: bool = False
    """Lets webhooks reach our own network and plain http: for tests on one machine alone."""
    deliver_every_s: Seconds = 1.0
    delivery_attempts: Annotated[int, Field(ge=1, le=100)] = 8
    delivery_backoff_s: Seconds = 30.0
    """Before the second try; doubles each time."""
