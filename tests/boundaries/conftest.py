import pytest

from exceptiondrive_records.db.settings import RecordsSettings


@pytest.fixture(scope="session")
def world_settings() -> RecordsSettings:
    """Settings of whoever wakes workers: the defaults."""
    return RecordsSettings()
