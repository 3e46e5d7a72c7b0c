"""`python -m tests.chaos [--short] [--resume] [--without] [F01 ...]`: inject faults, print the table.

Every fault is followed by the checker of histories and the invariants; what breaks one is LOST, and
the exit code is then 1. Outcomes are kept in `.state/chaos.json`, so that `--resume` goes on after an
interruption with those that have not survived yet.

`--without` takes the injection out of each fault, one at a time: each has to notice that nothing happened.
"""

import argparse
import json
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from rich.console import Console
from tests.chaos.suite import FAULTS, Fault, On, Outcome, run_fault, running
from tests.chaos.without import WITHOUT, fails_without

_CONSOLE = Console(width=150, soft_wrap=True, highlight=False)
_KEPT = Path(__file__).parents[2] / ".state" / "chaos.json"


def main() -> None:
    """Run the chosen faults."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that no process stays behind
    parser = argparse.ArgumentParser(
        prog="python -m tests.chaos",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("ids", nargs="*", help="ids of faults; all by default")
    parser.add_argument("--short", action="store_true", help="fewer files, shorter waits")
    parser.add_argument("--resume", action="store_true", help="leave out what survived before")
    parser.add_argument("--without", action="store_true", help="take the injections out")
    given = parser.parse_args()
    unknown = sorted(set(given.ids) - {fault.id for fault in FAULTS})
    if unknown:
        parser.error(f"no such fault: {', '.join(unknown)}")
    kept = _survived_before() if given.resume else {}
    chosen = [fault for fault in FAULTS if not given.ids or fault.id in given.ids]
    if given.without:
        sys.exit(_run_without(chosen))
    sys.exit(_run_all(chosen, kept, is_short=given.short))


def _run_without(chosen: list[Fault]) -> int:
    """Run each fault without its injections; return 1 if one of them does not fail."""
    faults = {fault.id: fault for fault in chosen}
    unnoticed = []
    for name in WITHOUT:
        fault = faults.get(name.split()[0])
        if fault is None:
            continue
        if (reason := _why_not(fault)) is not None:
            _CONSOLE.print(f"{name:11} {'SKIPPED':11} {reason}")
            continue
        outcome = fails_without(name, fault)
        word = "NOT NOTICED" if outcome.is_survived else "noticed"
        unnoticed += [name] * outcome.is_survived
        _CONSOLE.print(f"{name:11} {outcome.seconds:6.1f} s {word:11} {outcome.text}")
    _CONSOLE.print(f"not noticed: {', '.join(unnoticed) or 'none'}")
    return 1 if unnoticed else 0


def _run_all(chosen: list[Fault], kept: dict[str, str], *, is_short: bool) -> int:
    """Run what is left, print the table, and return the exit code."""
    began = time.monotonic()
    _CONSOLE.print(f"{'fault':5} {'seconds':>7} {'':7} injection: outcome")
    for fault in chosen:
        if fault.id in kept:
            _line(fault, "-", "earlier", kept[fault.id])
    left = [fault for fault in chosen if fault.id not in kept]
    skipped = {fault.id: reason for fault in left if (reason := _why_not(fault)) is not None}
    for fault in left:
        if fault.id in skipped:
            _line(fault, "-", "SKIPPED", skipped[fault.id])
    n_survived, lost = 0, []
    for outcome in _run([fault for fault in left if fault.id not in skipped], is_short):
        word = "ok" if outcome.is_survived else "LOST"
        _line(outcome.fault, f"{outcome.seconds:.1f}", word, outcome.text)
        if outcome.is_survived:
            n_survived += 1
            kept = _keep(outcome)
        else:
            lost.append(outcome.fault.id)
    n_run = n_survived + len(lost)
    _CONSOLE.print(
        f"{n_survived} of {n_run} faults survived, {len(skipped)} skipped, "
        f"{len(chosen) - n_run - len(skipped)} earlier; {time.monotonic() - began:.0f} s in all"
    )
    if lost:
        _CONSOLE.print(f"LOST: {' '.join(lost)}")
    return 1 if lost else 0


def _line(fault: Fault, seconds: str, word: str, text: str) -> None:
    where = f" [{fault.on.value}]"
    _CONSOLE.print(f"{fault.id:5} {seconds:>7} {word:7} {fault.injection}: {text}{where}")


def _run(chosen: list[Fault], is_short: bool) -> Iterator[Outcome]:
    for on in On:
        faults = [fault for fault in chosen if fault.on is on]
        if faults:
            with running(on, is_short=is_short) as run:
                for fault in faults:
                    yield run_fault(fault, run)


def _why_not(fault: Fault) -> str | None:
    return None if fault.why_not is None else fault.why_not()


def _survived_before() -> dict[str, str]:
    """Return what survived, and what came of it, by id."""
    with suppress(FileNotFoundError, ValueError):
        return {str(key): str(text) for key, text in json.loads(_KEPT.read_text()).items()}
    return {}


def _keep(outcome: Outcome) -> dict[str, str]:
    kept = {**_survived_before(), outcome.fault.id: outcome.text}
    _KEPT.parent.mkdir(exist_ok=True)
    _KEPT.write_text(json.dumps(kept, indent=2))
    return kept


if __name__ == "__main__":
    main()
