"""`python -m tests.canary FILE...`: name the files with the canary in them; exit 1 if there are any.

For files that others have open through SQLite: a process that itself has a database open must not
open and close the file besides, or its locks are gone (and with them, soon, the database).
"""

import sys
from pathlib import Path

from tests.canary.watch import Watch

if __name__ == "__main__":
    found = [name for name in sys.argv[1:] if Watch().look_in_file(Path(name))]
    print("\n".join(found))  # noqa: T201
    sys.exit(1 if found else 0)
