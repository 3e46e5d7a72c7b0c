"""`python -m tests.protections [NAME ...]`: take protections away, one at a time; print a table."""

import sys

from tests.protections.run import outcome_without
from tests.protections.table import PROTECTIONS


def main(names: list[str]) -> int:
    """Run all, or the ones named; return 1 if a test did not notice."""
    unknown = set(names) - {each.name for each in PROTECTIONS}
    if unknown:
        print(f"unknown: {', '.join(sorted(unknown))}")  # noqa: T201
        return 2
    unnoticed = 0
    for protection in PROTECTIONS:
        if names and protection.name not in names:
            continue
        is_noticed, line = outcome_without(protection)
        unnoticed += not is_noticed
        word = "noticed" if is_noticed else "NOT NOTICED"
        print(f"{protection.name:18} {word:12} {line}", flush=True)  # noqa: T201
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
