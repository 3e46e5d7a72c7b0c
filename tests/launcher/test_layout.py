"""The data folder: private where it must be, and one launcher's alone."""

import socket
import stat
from pathlib import Path

import pytest

from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.launcher.launch import require_free_port
from exceptiondrive_server.launcher.layout import (
    Address,
    BrokerFolder,
    Layout,
    data_lock,
    find_command,
    worker_environment,
)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_what_others_must_not_read_is_0700(tmp_path: Path) -> None:
    layout = Layout(tmp_path / "data")
    layout.create()
    layout.create()  # again does nothing
    folders = (layout.data, layout.logs, layout.private, layout.data / "uploads")
    assert {mode(folder) for folder in folders} == {0o700}
    assert mode(BrokerFolder(layout).path) == 0o700


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LaunchError, match="cannot use"):
        Layout(tmp_path / "file" / "data").create()


def test_a_second_launcher_on_the_same_folder_is_refused(tmp_path: Path) -> None:
    layout = Layout(tmp_path)
    with (
        data_lock(layout),
        pytest.raises(LaunchError, match="in use by another"),
        data_lock(layout),
    ):
        pass
    with data_lock(layout):
        pass


def test_a_deep_data_folder_gets_a_short_socket_elsewhere(tmp_path: Path) -> None:
    layout = Layout(tmp_path / ("deep" * 20))
    layout.create()
    folder = BrokerFolder(layout)
    assert layout.data not in folder.path.parents
    assert mode(folder.path) == 0o700
    folder.remove()
    assert not folder.path.exists()


def test_a_link_in_the_place_of_the_brokers_folder_is_refused(tmp_path: Path) -> None:
    """The server may put one there: what it leads to is neither opened nor given to anybody."""
    withheld = tmp_path / "splits"
    withheld.mkdir(mode=0o500)
    (tmp_path / "broker").symlink_to(withheld)
    with pytest.raises(LaunchError, match="no link"):
        BrokerFolder(Layout(tmp_path))
    assert mode(withheld) == 0o500


def test_given_settings_go_before_the_layouts(tmp_path: Path) -> None:
    given = {"EXCEPTIONDRIVE_DATABASE_URL": "postgresql+psycopg://elsewhere/db"}
    environment = Layout(tmp_path).environment(given)
    assert environment["EXCEPTIONDRIVE_DATABASE_URL"] == given["EXCEPTIONDRIVE_DATABASE_URL"]
    assert environment["EXCEPTIONDRIVE_FILE_STORE_URL"] == f"file://{tmp_path}/uploads"


def test_only_the_worker_is_told_where_the_private_store_is(tmp_path: Path) -> None:
    layout = Layout(tmp_path)
    shared = layout.environment({})
    assert str(layout.private) not in str(shared)
    assert worker_environment(layout, shared)["EXCEPTIONDRIVE_PRIVATE_DIR"] == str(layout.private)


def test_a_port_in_use_is_refused_with_a_way_out() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(LaunchError, match=rf"port {port} is in use.*--port"):
            require_free_port(Address("127.0.0.1", port))
    require_free_port(Address("127.0.0.1", port))


def test_a_host_of_another_machine_is_refused() -> None:
    with pytest.raises(LaunchError, match="cannot listen"):
        require_free_port(Address("192.0.2.1", 8000))


def test_a_missing_command_says_what_to_install() -> None:
    with pytest.raises(LaunchError, match="pip install"):
        find_command("exceptiondrive-nothing")
