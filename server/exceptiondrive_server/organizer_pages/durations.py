"""Lengths of time in words."""

from exceptiondrive_schemas.printable import counted


def duration_words(seconds: float) -> str:
    """Write a length of time in its largest unit: `12 s`, `5 minutes`, `3 hours`, `2 days`."""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    if seconds < 90 * 60:
        return counted(round(seconds / 60), "minute")
    if seconds < 36 * 3600:
        return counted(round(seconds / 3600), "hour")
    return counted(round(seconds / 86400), "day")
