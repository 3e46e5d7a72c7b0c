"""The rows of a board, one by one and side by side."""
