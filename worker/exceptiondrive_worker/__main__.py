"""The command `exceptiondrive-worker`."""

import gc
import os

BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""By default numpy multiplies matrices on every core in every process; its threads then busy-wait
for each other. The products are exact in any order (`bootstrap.GRID`), so this changes no bit."""


def main() -> None:
    """Import all commands, then run one.

    Imported objects live until the end: collecting garbage meanwhile takes a fifth of the start.
    """
    os.environ.setdefault(BLAS_THREADS, "1")
    gc.disable()
    from exceptiondrive_worker import operator_cli

    gc.freeze()
    gc.enable()
    operator_cli.main()


if __name__ == "__main__":
    main()
