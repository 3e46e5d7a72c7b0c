"""Which settings of a phase fit together."""

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.tables import Phase


def check_phase(phase: Phase, *, is_freeze_new: bool = True) -> None:
    """Refuse settings that contradict each other; all of them are named at once.

    Args:
        phase: With its new settings.
        is_freeze_new: Whether `freezes_at` or `closes_at` is being set now; the action freeze may
            have set it after the deadline.

    Raises:
        InvalidRecord: With one sentence for each contradiction.
    """
    faults = [*_dates(phase), *_limits(phase)]
    if is_freeze_new and _freezes_too_late(phase):
        faults.append(
            "freezes_at must lie before closes_at: a board that freezes after the deadline hides "
            "nothing. After the deadline use the action freeze."
        )
    if faults:
        raise InvalidRecord(" ".join(faults))


def _dates(phase: Phase) -> list[str]:
    freezes_at, opens_at, closes_at = phase.life.freezes_at, phase.opens_at, phase.closes_at
    faults = []
    if opens_at is not None and closes_at is not None and closes_at <= opens_at:
        faults.append("A phase must close after it opens.")
    if freezes_at is not None and opens_at is not None and freezes_at <= opens_at:
        faults.append("freezes_at must lie after opens_at.")
    if phase.life.late_entries == "own_view" and closes_at is None:
        faults.append("Late entries need a deadline: set closes_at, or refuse them.")
    return faults


def _freezes_too_late(phase: Phase) -> bool:
    freezes_at, closes_at = phase.life.freezes_at, phase.closes_at
    return freezes_at is not None and closes_at is not None and freezes_at >= closes_at


def _limits(phase: Phase) -> list[str]:
    limits = (
        phase.quota_per_day,
        phase.rejected_per_day,
        phase.quota_total,
        phase.quota_concurrent,
    )
    if any(limit is not None and limit < 1 for limit in limits):
        return ["Quotas must be at least 1."]
    return []
