"""News of a phase, questions and answers."""
