"""Challenges, as commands find them."""

from exceptiondrive.errors import ServerError
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge, UnknownChallengeError


def challenge_of(challenge_id: str) -> Challenge:
    """Return the challenge with this id.

    Raises:
        ServerError: It came after this client.
    """
    try:
        return CHALLENGES[challenge_id]
    except UnknownChallengeError as error:
        raise ServerError(
            "unknown_challenge",
            error.sentence,
            "Install the newest client, from the page /client/ of the server.",
        ) from None
