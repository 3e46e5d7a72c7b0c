"""The sample split, whose regions are known, and an oracle that publishes as the server does."""

import pytest
from tests.leak.oracle import SAMPLE, Oracle

from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_worker.splits.store import LoadedSplit, load_split, read_split


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    return packaged_protocol()


@pytest.fixture(scope="session")
def sample_split(protocol: ProtocolDocument) -> LoadedSplit:
    return load_split(read_split(SAMPLE), protocol)


@pytest.fixture
def oracle(sample_split: LoadedSplit, protocol: ProtocolDocument) -> Oracle:
    return Oracle(sample_split, protocol)
