"""`python -m exceptiondrive_schemas.publish`: write all generated files of this checkout."""

import sys
from pathlib import Path

from exceptiondrive_schemas.publish.written_files import written_files


def main() -> None:
    """Write the files, relative to the repository of this package."""
    root = Path(__file__).parents[3]
    if not (root / "pyproject.toml").is_file():
        sys.exit("this command writes into a checkout of the repository, and there is none here")
    for path, text in written_files().items():
        target = root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main()
