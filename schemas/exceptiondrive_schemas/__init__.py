"""Everything that crosses a process boundary, and nothing else: files, messages, names and codes.

All other packages depend on this one; it depends on pydantic alone.
"""

from exceptiondrive_schemas.check import rules as _rules  # noqa: F401  registers all challenges
