"""What stops a run of the agent: the client's errors, with its exit codes."""

from collections.abc import Iterator
from contextlib import contextmanager

from exceptiondrive.errors import InvalidArgumentError, NetworkError, NotAllowedError
from exceptiondrive_endpoints.errors import EndpointError, EndpointGoneError, EndpointRefusesError


class AgentError(InvalidArgumentError):
    """The run cannot start or go on as it was asked for; exit 2."""

    def __init__(self, sentence: str, advice: str = "") -> None:
        super().__init__("agent_run_invalid", sentence, advice)


@contextmanager
def as_client_errors() -> Iterator[None]:
    """Tell what stopped an endpoint as an error of the client.

    Raises:
        NotAllowedError: The endpoint refuses every sample: the key, or the account; exit 4.
        NetworkError: Samples could not be asked; exit 5.
        AgentError: The address, the model or the journal is wrong; exit 2.
    """
    try:
        yield
    except EndpointRefusesError as error:
        raise NotAllowedError("endpoint_refuses", error.sentence, error.advice) from None
    except EndpointGoneError as error:
        raise NetworkError("endpoint_gone", error.sentence, error.advice) from None
    except EndpointError as error:
        raise AgentError(error.sentence, error.advice) from None
