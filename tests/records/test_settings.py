"""Settings: malformed or misspelt ones stop the start with one clear sentence."""

import pytest

from exceptiondrive_records.settings import RecordsSettings, SettingsError, load_settings


def test_the_defaults_are_those_that_survived_every_fault() -> None:
    settings = load_settings(RecordsSettings)
    assert (settings.lease_s, settings.max_attempts, settings.reconcile_every_s) == (120, 4, 1)
    assert settings.window is None


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("DATABASE_URL", "mysql://x", "must start with sqlite:///"),
        ("BROKER_URL", "amqp://x", "must start with redis://"),
        ("FILE_STORE_URL", "ftp://x", "must start with file:///"),
        ("LEASE_S", "-1", "greater than 0"),
        ("MAX_ATTEMPTS", "many", "valid integer"),
    ],
)
def test_a_malformed_value_is_named(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, words: str
) -> None:
    monkeypatch.setenv(f"EXCEPTIONDRIVE_{variable}", value)
    with pytest.raises(SettingsError, match=words) as refused:
        load_settings(RecordsSettings)
    assert f"EXCEPTIONDRIVE_{variable}" in str(refused.value)


def test_a_misspelt_variable_is_not_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABSE_URL", "sqlite:///x")
    with pytest.raises(SettingsError, match="did you mean EXCEPTIONDRIVE_DATABASE_URL"):
        load_settings(RecordsSettings)


def test_variables_of_other_parts_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TOKEN", "SERVER", "PRIVATE_DIR", "MAX_UPLOAD_BYTES", "MAX_INFLATED_BYTES"):
        monkeypatch.setenv(f"EXCEPTIONDRIVE_{name}", "x")
    assert load_settings(RecordsSettings).max_attempts == 4
