"""The page `docs/errors.md`: every fault code with a real report, made by the checker itself."""

from exceptiondrive_schemas.check.messages import MESSAGES
from exceptiondrive_schemas.faults import MAX_EXAMPLES, FaultCode, FaultGroup
from exceptiondrive_schemas.publish.broken_files import report_of
from exceptiondrive_schemas.publish.indented import indented

HEAD = f"""# What can be wrong with a submission file

<!-- Written by `python -m exceptiondrive_schemas.publish`; do not edit. -->

`exceptiondrive check FILE` and the server run the same checker and say the same. It reads the whole
file in one pass and reports every fault: a code, the place as a JSON path, the sample id, what was
expected, what was found, and often what probably went wrong. The first examples of each code are
listed (at most {MAX_EXAMPLES}), and the total is always told. A refused file costs no quota.

Codes are stable: scripts may rely on them. Each one stands here with the report of a file that is
broken in just this way.

"""


def errors_page() -> str:
    """Return the whole page."""
    index = "".join(f"- [`{code}`](#{code})\n" for code in FaultCode)
    return HEAD + index + "".join(_section(code) for code in FaultCode)


def _section(code: FaultCode) -> str:
    report = report_of(code)
    group = next(group for group in report.faults if group.code is code)
    notes = "".join(f"\nNote: {note}\n" for note in report.notes)
    return f"\n## {code}\n\n{MESSAGES[code]}\n\n```json\n{_shown(group)}```\n{notes}"


def _shown(group: FaultGroup) -> str:
    return indented(group.model_dump_json(exclude_none=True))
