"""Run the benchmarks: `python -m benchmarks [section ...]`."""

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: CPU time of one thread

import argparse
import platform

from benchmarks import (
    command_line,
    growth,
    long_boards,
    measuring,
    new_clearance,
    page,
    processes,
    rescoring,
    uncertainty,
    upload,
    upload_to_rank,
)
from benchmarks.report import note, show_targets
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_worker.process import keep_memory

SECTIONS = {
    # first, as it makes files: where thousands were deleted a moment ago, ext4 takes 20 times as long for one
    "upload_to_rank": upload_to_rank.run,
    "measuring": measuring.run,
    "upload": upload.run,
    "rescoring": rescoring.run,
    "bootstrap": uncertainty.run,
    "growth": growth.run,
    "boards": page.run,
    "processes": processes.run,
    "commands": command_line.run,
    "new_clearance": new_clearance.run,
    "long_boards": long_boards.run,
}


def main() -> None:
    """Print the chosen sections, all of them by default."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("sections", nargs="*", metavar="section", help=", ".join(SECTIONS))
    chosen = parser.parse_args().sections or list(SECTIONS)
    unknown = sorted(set(chosen) - SECTIONS.keys())
    if unknown:
        parser.error(f"no such section: {', '.join(unknown)}; there are {', '.join(SECTIONS)}")
    keep_memory()  # as in every worker
    note(
        f"CPU time of one thread, medians; candidates take turns, ratios are taken round by round. "
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    )
    for section in chosen:
        SECTIONS[section](packaged_protocol())
    show_targets()


if __name__ == "__main__":
    main()
