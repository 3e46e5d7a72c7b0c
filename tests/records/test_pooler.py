"""A pooler between us and PostgreSQL mixes sessions up: none is worked with."""

import os
import shutil
import socket
import subprocess
from pathlib import Path
from urllib.parse import parse_qs

import pytest
from sqlalchemy import make_url, text
from sqlalchemy.exc import OperationalError
from tests.support.databases import POSTGRES_ALONE
from tests.support.processes import free_port, wait_until

from exceptiondrive_records.db.database import Database, sentence_of


def _listens(port: int) -> bool:
    with socket.socket() as door:
        return door.connect_ex(("127.0.0.1", port)) == 0


@POSTGRES_ALONE
def test_a_pooler_that_drops_settings_is_refused(database_url: str, tmp_path: Path) -> None:
    """PgBouncer refuses our settings by itself, and is commonly told to ignore them instead."""
    program = shutil.which("pgbouncer", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if program is None:
        pytest.skip("no PgBouncer: as root, apt-get install pgbouncer")
    folder = parse_qs(database_url.partition("?")[2])["host"][0]
    port = free_port()
    config = (
        f"[databases]\n* = host={folder} user=postgres\n"
        f"[pgbouncer]\nlisten_addr = 127.0.0.1\nlisten_port = {port}\nunix_socket_dir =\n"
        "auth_type = any\npool_mode = transaction\n"
        "ignore_startup_parameters = extra_float_digits,options\n"
    )
    file = tmp_path / "pgbouncer.ini"
    file.write_text(config)
    with file.open() as told:
        pooler = subprocess.Popen(
            [program, "/dev/stdin"],
            stdin=told,
            stderr=subprocess.DEVNULL,
            user=Path(folder).stat().st_uid,  # it refuses to run as root, as PostgreSQL does
        )
    address = make_url(database_url).set(host="127.0.0.1", port=port, query={})
    database = Database(address.render_as_string(False))
    try:
        wait_until(lambda: _listens(port), "PgBouncer to listen")
        with pytest.raises(OperationalError) as refused, database.read() as session:
            session.execute(text("SELECT 1"))
        assert "name PostgreSQL itself" in sentence_of(refused.value)
    finally:
        pooler.terminate()
        pooler.wait(30)
        database.dispose()
