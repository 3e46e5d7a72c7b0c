"""Client of the ExceptionDrive leaderboard: check, evaluate, submit, follow.

>>> from exceptiondrive import Client, check_file
>>> report = check_file("planner.json")
>>> view = Client().submit("planner.json", phase="dev", method="Planner").wait()

The public names are loaded when first used, so that `exceptiondrive --help` and `recorder` stay
light.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from exceptiondrive.version import __version__ as __version__

if TYPE_CHECKING:
    from exceptiondrive.async_client import AsyncClient, AsyncSubmission
    from exceptiondrive.checking import check_file
    from exceptiondrive.client import Client, Submission
    from exceptiondrive.dataframes import to_dataframe
    from exceptiondrive.errors import (
        ExceptionDriveError,
        InvalidArgumentError,
        InvalidFileError,
        NetworkError,
        NotAllowedError,
        NotFoundError,
        NotSignedInError,
        QuotaError,
        RecorderError,
        ScoringFailedError,
        ServerError,
        WaitTimeoutError,
    )
    from exceptiondrive.evaluation import evaluate_file, evaluate_samples
    from exceptiondrive.plot import plot_file
    from exceptiondrive.recorder import Recorder, StrategyRecorder

__all__ = [
    "AsyncClient",
    "AsyncSubmission",
    "Client",
    "ExceptionDriveError",
    "InvalidArgumentError",
    "InvalidFileError",
    "NetworkError",
    "NotAllowedError",
    "NotFoundError",
    "NotSignedInError",
    "QuotaError",
    "Recorder",
    "RecorderError",
    "ScoringFailedError",
    "ServerError",
    "StrategyRecorder",
    "Submission",
    "WaitTimeoutError",
    "check_file",
    "evaluate_file",
    "evaluate_samples",
    "plot_file",
    "to_dataframe",
]

_HOMES = {
    "AsyncClient": "async_client",
    "AsyncSubmission": "async_client",
    "Client": "client",
    "Recorder": "recorder",
    "StrategyRecorder": "recorder",
    "Submission": "client",
    "check_file": "checking",
    "evaluate_file": "evaluation",
    "evaluate_samples": "evaluation",
    "plot_file": "plot",
    "to_dataframe": "dataframes",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES.get(name, 'errors')}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
