"""A small example of each fault in a submission file: what is wrong, what is right."""

from collections.abc import Mapping
from types import MappingProxyType

from exceptiondrive_schemas.faults import FaultCode

Example = tuple[str, str]
"""Wrong, right."""

FAULT_EXAMPLES: Mapping[FaultCode, Example] = MappingProxyType(
    {
        FaultCode.NOT_JSON: ('{"schema": "exceptiondrive.planning/1",', "a complete JSON object"),
        FaultCode.NOT_UTF8: ("a file saved as UTF-16 or Latin-1", "the same file saved as UTF-8"),
        FaultCode.TRAILING_DATA: ('{"schema": ...} {"schema": ...}', '{"schema": ...}'),
        FaultCode.DUPLICATE_KEY: ('{"split": "a", "split": "b"}', '{"split": "a"}'),
        FaultCode.UNKNOWN_KEY: (
            '{"sample_id": "x", "source": null, "edited": null, "method": "M"}',
            '{"sample_id": "x", "source": null, "edited": null}',
        ),
        FaultCode.MISSING_KEY: (
            '{"sample_id": "x", "edited": [[...], ...]}',
            '{"sample_id": "x", "source": null, "edited": [[...], ...]}',
        ),
        FaultCode.WRONG_TYPE: ('["2.5", "0.0"]', "[2.5, 0.0]"),
        FaultCode.WRONG_SCHEMA: ('"schema": "planning"', '"schema": "exceptiondrive.planning/1"'),
        FaultCode.WRONG_SPLIT: ('"split": "sample"', '"split": the split of the phase'),
        FaultCode.UNKNOWN_SAMPLE: ('"sample_id": "scene-0103_12"', "an id of the manifest"),
        FaultCode.MISSING_SAMPLE: ("no prediction for one id", '"source": null, "edited": null'),
        FaultCode.DUPLICATE_SAMPLE: ("one id twice", "every id once"),
        FaultCode.WRONG_WAYPOINT_COUNT: (
            "[[0, 0], [2, 0], [4, 0], [6, 0], [8, 0], [10, 0], [12, 0]]",
            "[[2, 0], [4, 0], [6, 0], [8, 0], [10, 0], [12, 0]]",
        ),
        FaultCode.WRONG_WAYPOINT_SHAPE: ("[2.0, 0.1, 0.0]", "[2.0, 0.1]"),
        FaultCode.NON_FINITE: ('"edited": [[NaN, 0], ...]', '"edited": null'),
        FaultCode.OUT_OF_BOUNDS: ("[1301.2, 880.5]", "[12.4, 0.3]"),
        FaultCode.STEP_TOO_LONG: ("[[2, 0], [90, 0], ...]", "[[2, 0], [4, 0], ...]"),
        FaultCode.WRONG_FRAME: ("[0.1, 5.0]: x right, y forward", "[5.0, -0.1]: x forward, y left"),
        FaultCode.UNKNOWN_STRATEGY: ('"strategy": "stop"', '"strategy": "C"'),
    }
)
