"""The stages that ask a model, in order, by their names for `run`."""

from exceptiondrive_build.asking import Stage
from exceptiondrive_build.chat import ReviewStage, ScreenStage
from exceptiondrive_build.editing import EditStage

STAGES: dict[str, type[Stage]] = {
    stage.kind: stage for stage in (ScreenStage, EditStage, ReviewStage)
}
