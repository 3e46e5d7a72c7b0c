"""The system of record: its state stays correct whichever process dies, and whenever.

Reasons: docs/decisions/0003-sql-is-the-queue.md.
"""

from exceptiondrive_records import tables as tables
