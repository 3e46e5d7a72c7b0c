"""Structured logs: one JSON object a line on stdout, with the request id, without secrets."""

import logging
import sys

import structlog

from exceptiondrive_records.operations.log_stream import patient


def set_up_logs() -> None:
    """Send all logs of this process to stdout as JSON lines."""
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.JSONRenderer(),
        ],
        logger_factory=structlog.PrintLoggerFactory(patient(sys.stdout)),
        cache_logger_on_first_use=True,
    )
    logging.basicConfig(stream=sys.stdout, level=logging.WARNING, format="%(message)s")
