"""The benchmark of the commands scores against a split that a server would take, too."""

import json

from benchmarks.command_line import scorable_workload, split_document
from benchmarks.upload import make_manifest

from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.faults import split_faults


def test_the_commands_are_measured_with_a_split_without_a_fault() -> None:
    protocol, n_samples = packaged_protocol(), 400
    workload, manifest = scorable_workload(protocol, n_samples), make_manifest(n_samples, protocol)
    document = split_document(workload, manifest, protocol)
    assert split_faults(Split.model_validate_json(json.dumps(document)), protocol) == ()
