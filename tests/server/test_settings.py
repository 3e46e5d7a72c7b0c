"""Settings that the server alone has: a wrong one stops the start and says what to write."""

import pytest

from exceptiondrive_records.db.settings import SettingsError, load_settings
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES
from exceptiondrive_server.web.settings import ServerSettings


@pytest.mark.parametrize(
    "proxies", ["172.30.250.1/24", "10.0.0.0/33", "127.0.0.1,proxy", "127.0.0.1,", "*"]
)
def test_a_proxy_that_would_not_be_believed_stops_the_start(
    monkeypatch: pytest.MonkeyPatch, proxies: str
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_TRUSTED_PROXIES", proxies)
    with pytest.raises(SettingsError, match=r"EXCEPTIONDRIVE_TRUSTED_PROXIES: .* no address"):
        load_settings(ServerSettings)


def test_an_upload_may_be_as_large_as_its_json_and_no_larger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_MAX_UPLOAD_BYTES", str(MAX_INFLATED_BYTES))
    assert load_settings(ServerSettings).max_upload_bytes == MAX_INFLATED_BYTES
    monkeypatch.setenv("EXCEPTIONDRIVE_MAX_UPLOAD_BYTES", str(MAX_INFLATED_BYTES + 1))
    with pytest.raises(SettingsError, match="EXCEPTIONDRIVE_MAX_UPLOAD_BYTES"):
        load_settings(ServerSettings)


@pytest.mark.parametrize(
    "proxies", ["", "127.0.0.1", "172.30.250.0/24, ::1", "10.0.0.0/8,fd00::/8"]
)
def test_addresses_and_networks_of_proxies_are_taken(
    monkeypatch: pytest.MonkeyPatch, proxies: str
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_TRUSTED_PROXIES", proxies)
    assert load_settings(ServerSettings).trusted_proxies == proxies
