"""The stages that ask a model, in their order, by the name that `run` takes."""

from exceptiondrive_build.asking import Stage
from exceptiondrive_build.chat import ReviewStage, ScreenStage
from exceptiondrive_build.editing import EditStage

STAGES: dict[str, type[Stage]] = {
    stage.kind: stage for stage in (ScreenStage, EditStage, ReviewStage)
}
