"""The profile of a scored file, computed on request: most clients show it before the upload."""

from exceptiondrive_records.work.profiles import ask_for_profile, was_profile_asked_for
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_server.web.services import Services


def asked_for_profile(services: Services, seen: SubmissionView) -> SubmissionView:
    """Request the profile of a submission's file, unless it is there or already requested."""
    is_told = seen.report is not None or seen.awaits_profile
    if is_told or seen.status is not SubmissionStatus.SCORED:
        return seen
    if not CHALLENGES[seen.challenge].has_profile:
        return seen
    with services.database.read() as session:
        if was_profile_asked_for(session, seen.id):  # and nothing came of it
            return seen
    with services.database.write() as session:
        ask_for_profile(session, seen.id)
    services.dispatcher.wake(Lane.LIVE)
    return seen.model_copy(update={"awaits_profile": True})
