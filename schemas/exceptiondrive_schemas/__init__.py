"""What crosses a process boundary, and nothing else: files, messages, names and codes.

Every other package stands on this one; it stands on pydantic alone.
"""

from exceptiondrive_schemas.check import rules as _rules  # noqa: F401  registers all challenges
