import pytest

from exceptiondrive_records.db.settings import SettingsError, load_settings
from exceptiondrive_worker.settings import WorkerSettings


def test_the_defaults_are_in_order() -> None:
    settings = load_settings(WorkerSettings)
    assert settings.soft_time_limit_s < settings.time_limit_s < settings.lease_s
    assert settings.heartbeat_every_s * 2 <= settings.heartbeat_ttl_s


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("LEASE_S", "80"),
        ("SOFT_TIME_LIMIT_S", "90"),
        ("HEARTBEAT_EVERY_S", "10"),
        ("MEMORY_HEADROOM_BYTES", "1000"),
    ],
)
def test_values_that_break_a_promise_stop_the_start(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str
) -> None:
    monkeypatch.setenv(f"EXCEPTIONDRIVE_{name}", value)
    with pytest.raises(SettingsError):
        load_settings(WorkerSettings)
