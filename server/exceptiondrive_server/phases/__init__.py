"""The dated stages of a challenge and their policy."""
