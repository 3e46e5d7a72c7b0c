"""Errors that an organizer sees: one sentence, and what to do about it."""


class BuildError(Exception):
    """The command cannot do what was asked; no decision is lost.

    Attributes:
        sentence: What is wrong.
        advice: What to do next; may be empty.
    """

    def __init__(self, sentence: str, advice: str = "") -> None:
        self.sentence = sentence
        self.advice = advice
        super().__init__(f"{sentence} {advice}".strip())
