"""The command `exceptiondrive`, and `python -m exceptiondrive`."""

import gc

COLLECT_AFTER = 1_000_000
"""So many more objects than before, and cycles are looked for: a file of 20,000 pairs has fewer."""


def main() -> None:
    """Import what a command needs, and run it.

    It reads a file and ends. Looking for cycles among its objects again and again would take a fifth
    of its time with 20,000 pairs, and looking through all of them once more before the end a tenth
    with 3,181: whatever a process holds is given back when it ends.
    """
    gc.set_threshold(COLLECT_AFTER)
    from exceptiondrive import cli

    try:
        cli.main()
    finally:
        gc.freeze()


if __name__ == "__main__":
    main()
