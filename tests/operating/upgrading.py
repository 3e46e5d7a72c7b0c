"""Steps of an upgrade, as the runbook has them."""

import signal
import threading

from tests.chaos.history import Call
from tests.chaos.run import Run
from tests.chaos.topology import Topology
from tests.operating.held_upload import HeldUpload
from tests.support.documents import digest_of


def stop_while_uploading(run: Run) -> None:
    """Stop the first server in the middle of an upload, which it still answers."""
    topology, data = run.topology, run.clients.new_file()
    began_s = run.history.now_s()
    held = HeldUpload(topology, data, "held")
    codes: list[int] = []
    stopping = threading.Thread(target=lambda: codes.append(topology.server.stop(60)))
    stopping.start()
    topology.wait_until(lambda: not topology.readiness(), "the server to take nothing new")
    status, view = held.finish()
    stopping.join(60)
    took_s = run.history.now_s() - began_s
    call = Call("alpha", digest_of(data), "held", began_s, took_s, status, view["id"])
    run.history.note(call)
    assert (status, codes) == (202, [-signal.SIGTERM])


def make_schema_newer(topology: Topology) -> None:
    """What `migrate` of a later release does: it only adds."""
    assert topology.postgres is not None
    with topology.postgres.connect() as connection:
        connection.execute("ALTER TABLE submissions ADD COLUMN added_later VARCHAR")
        connection.execute("ALTER TABLE work ADD COLUMN added_later VARCHAR")
        connection.execute("CREATE TABLE made_later (id INTEGER PRIMARY KEY)")
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
