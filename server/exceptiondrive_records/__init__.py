"""The system of record: what is true, whatever process dies when (DESIGN.md 4)."""
