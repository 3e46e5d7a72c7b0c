"""The system of record: what is true, whatever process dies when (DESIGN.md 4)."""

from exceptiondrive_records import tables as tables
