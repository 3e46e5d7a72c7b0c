"""The command `exceptiondrive-worker`."""

import gc
import os

BLAS_THREADS = "OPENBLAS_NUM_THREADS"
"""numpy would let every slot multiply matrices on every core, which waits busily for the others. What is
multiplied is exact, in any order (`bootstrap.GRID`), so that it moves no bit."""


def main() -> None:
    """Import all commands, then run one.

    What importing makes stays to the end: looking for garbage meanwhile takes a fifth of the start.
    """
    os.environ.setdefault(BLAS_THREADS, "1")
    gc.disable()
    from exceptiondrive_worker import operator_cli

    gc.freeze()
    gc.enable()
    operator_cli.main()


if __name__ == "__main__":
    main()
