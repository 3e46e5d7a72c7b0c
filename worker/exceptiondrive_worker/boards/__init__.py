"""Boards as the worker makes them: rows, comparisons, references, what may be told of them."""
