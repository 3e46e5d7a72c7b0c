"""E-mail over the SMTP server of the settings."""

import smtplib
import ssl
from email.message import EmailMessage

from exceptiondrive_records.notices.settings import NoticeSettings
from exceptiondrive_records.notices.webhooks import NotDelivered
from exceptiondrive_schemas.printable import one_line
from exceptiondrive_schemas.rescoring import ChangedEntry, NotificationView, Standing

_TIMEOUT_S = 10.0


def send_email(settings: NoticeSettings, to: str, notice: NotificationView) -> None:
    """Send a notification as plain text.

    Raises:
        NotDelivered: No server is set, or it did not take the message.
    """
    if settings.smtp_host is None:
        raise NotDelivered("no SMTP server is set (EXCEPTIONDRIVE_SMTP_HOST)")
    message = message_of(settings, to, notice)
    try:
        with _server(settings) as server:
            if settings.smtp_user is not None:
                server.login(settings.smtp_user, settings.smtp_password.get_secret_value())
            server.send_message(message)
    except (OSError, smtplib.SMTPException) as error:
        raise NotDelivered(f"the mail server did not take it ({type(error).__name__})") from None


def message_of(settings: NoticeSettings, to: str, notice: NotificationView) -> EmailMessage:
    """Return the message; no name of a team or phase can add a header or a line to it."""
    message = EmailMessage()
    message["Subject"] = one_line(notice.title)
    message["From"] = settings.mail_from
    message["To"] = to
    message["Message-ID"] = f"<{notice.id}@{settings.mail_from.rsplit('@', 1)[-1].rstrip('>')}>"
    message.set_content(text_of(notice, settings.public_url))
    return message


def text_of(notice: NotificationView, site_url: str) -> str:
    """Return the words of the message."""
    changes = [f"- {one_line(sentence)}" for sentence in notice.what_changed]
    entries = [line for entry in notice.entries for line in _entry_lines(entry)]
    address = f"{site_url.rstrip('/')}{notice.comparison}"
    lines = [
        f"To team {one_line(notice.team)}:",
        "",
        f"{one_line(notice.title)} (before: {notice.from_protocol.version}). What changed:",
        *changes,
        "",
        "Your published numbers:",
        *entries,
        "",
        f"The whole comparison: {address}",
    ]
    return "\n".join(lines) + "\n"


def _entry_lines(entry: ChangedEntry) -> list[str]:
    return [
        f"{one_line(entry.method)} ({entry.submission_id})",
        f"  before: {_standing(entry.old)}",
        f"  now:    {_standing(entry.new)}",
    ]


def _standing(standing: Standing | None) -> str:
    if standing is None:
        return "not on the board"
    rank = "unranked" if standing.rank is None else f"rank {standing.rank}"
    values = [f"{key} {value:g}" for key, value in standing.metrics.items() if value is not None]
    return ", ".join([rank, *values, *_effect_words(standing)])


def _effect_words(standing: Standing) -> list[str]:
    effect = {} if standing.reminder_effect is None else standing.reminder_effect.by_metric
    return [f"reminder {key} {value:+g}" for key, value in effect.items() if value is not None]


def _server(settings: NoticeSettings) -> smtplib.SMTP:
    assert settings.smtp_host is not None
    where = (settings.smtp_host, settings.smtp_port)
    context = ssl.create_default_context()
    if settings.smtp_security == "tls":
        return smtplib.SMTP_SSL(*where, timeout=_TIMEOUT_S, context=context)
    server = smtplib.SMTP(*where, timeout=_TIMEOUT_S)
    if settings.smtp_security == "starttls":
        server.starttls(context=context)
    return server
