"""The system of record: what is true, whatever process dies when.

Reasons: docs/decisions/0003-sql-is-the-queue.md.
"""

from exceptiondrive_records import tables as tables
