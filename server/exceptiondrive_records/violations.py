"""What a checker of the records reports."""

from dataclasses import dataclass


@dataclass(frozen=True, order=True)
class Violation:
    """Something that must never be: which rule, of what, and how."""

    rule: str
    subject: str
    text: str

    def __str__(self) -> str:
        return f"{self.rule}: {self.subject}: {self.text}"
