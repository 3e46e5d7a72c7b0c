"""Protocol updates: draft, score in the background, compare, apply, roll back (docs/rescoring.md)."""
