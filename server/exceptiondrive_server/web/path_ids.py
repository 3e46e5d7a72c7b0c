"""Path parameters that the routes of several nouns share, in pages and API."""

from typing import Annotated

from fastapi import Path

PhaseId = Annotated[str, Path(max_length=64, description="id of a phase")]
SubmissionId = Annotated[str, Path(max_length=64, description="id of a submission")]
TeamId = Annotated[str, Path(max_length=64, description="id of a team")]
