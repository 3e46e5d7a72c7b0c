"""`python -m tests.chaos [--short] [F01 ...]`: inject faults, print the table, fail on violations."""

import argparse
import sys
import time
from collections.abc import Iterator

from rich.console import Console
from tests.chaos.suite import FAULTS, NOT_INJECTED, Fault, On, Outcome, run_fault, running, why_not

_CONSOLE = Console(width=150, soft_wrap=True, highlight=False)


def main() -> None:
    """Run the chosen faults."""
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("ids", nargs="*", help="ids of faults; all by default")
    parser.add_argument("--short", action="store_true", help="only the short form")
    parser.add_argument("--keep", action="store_true", help="keep folders and logs")
    given = parser.parse_args()
    chosen = [
        fault
        for fault in FAULTS
        if (not given.ids or fault.id in given.ids) and (not given.short or fault.is_short)
    ]
    began = time.monotonic()
    outcomes = list(_run(chosen))
    for identifier, reason in NOT_INJECTED.items():
        if not given.ids:
            _CONSOLE.print(f"{identifier:5} -      {reason}")
    lost = [outcome for outcome in outcomes if not outcome.is_survived]
    _CONSOLE.print(
        f"{len(outcomes) - len(lost)} of {len(outcomes)} faults survived, "
        f"{time.monotonic() - began:.0f} s in all"
    )
    sys.exit(1 if lost else 0)


def _run(chosen: list[Fault]) -> Iterator[Outcome]:
    _CONSOLE.print(f"{'fault':5} {'seconds':>7} {'':4} injection: outcome")
    for on in On:
        faults = [fault for fault in chosen if fault.on is on]
        reason = why_not(on)
        if reason is not None or not faults:
            for fault in faults:
                _CONSOLE.print(f"{fault.id:5} {'-':>7} skip {fault.injection}: {reason}")
            continue
        with running(on) as run:
            for fault in faults:
                outcome = run_fault(fault, run)
                word = "ok  " if outcome.is_survived else "LOST"
                _CONSOLE.print(
                    f"{fault.id:5} {outcome.seconds:7.1f} {word} {fault.injection}: {outcome.text}"
                    f" [{on.value}]"
                )
                yield outcome


if __name__ == "__main__":
    main()
