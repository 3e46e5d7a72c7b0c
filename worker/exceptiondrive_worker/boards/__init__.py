"""Boards as the worker builds them: rows, comparisons, references, and rounding for publication."""
