"""Which settings of a phase fit together."""

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.identifiers import checked_text
from exceptiondrive_records.tables import Phase
from exceptiondrive_schemas.form_fields import fields_of
from exceptiondrive_schemas.phase_settings import PhaseSettings


def check_phase(phase: Phase, *, is_freeze_new: bool = True) -> None:
    """Refuse settings that contradict each other; all of them are named at once.

    Args:
        phase: With its new settings.
        is_freeze_new: Whether `freezes_at` or `closes_at` is being set now; the action freeze may
            have set it after the deadline.

    Raises:
        InvalidRecord: With one sentence for each contradiction.
    """
    _check_texts(phase)
    faults = _dates(phase)
    if is_freeze_new and _freezes_too_late(phase):
        faults.append(
            "freezes_at must lie before closes_at: a board that freezes after the deadline hides "
            "nothing. After the deadline use the action freeze."
        )
    if faults:
        raise InvalidRecord(" ".join(faults))


def _dates(phase: Phase) -> list[str]:
    freezes_at, opens_at, closes_at = phase.policy.freezes_at, phase.opens_at, phase.closes_at
    faults = []
    if opens_at is not None and closes_at is not None and closes_at <= opens_at:
        faults.append("A phase must close after it opens.")
    if freezes_at is not None and opens_at is not None and freezes_at <= opens_at:
        faults.append("freezes_at must lie after opens_at.")
    if phase.policy.late_entries == "own_view" and closes_at is None:
        faults.append("Late entries need a deadline: set closes_at, or refuse them.")
    return faults


def _freezes_too_late(phase: Phase) -> bool:
    freezes_at, closes_at = phase.policy.freezes_at, phase.closes_at
    return freezes_at is not None and closes_at is not None and freezes_at >= closes_at


def _check_texts(phase: Phase) -> None:
    """Keep the texts without blanks around them, and refuse what cannot be shown."""
    for field in fields_of(PhaseSettings):
        if field.kind in ("text", "lines"):
            text = checked_text(
                field.name,
                getattr(phase, field.name),
                max_length=field.max_length,
                may_be_empty=not field.is_required,
                may_have_lines=field.kind == "lines",
            )
            setattr(phase, field.name, text)
