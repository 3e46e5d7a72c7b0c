"""`exceptiondrive-server`: the operator's commands on the machine itself.

What only one long-running command needs, such as the broker's client, is imported when it is called.
"""

import gc
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.exc import DBAPIError

from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.db.roles import Role, grant_to_files, grants
from exceptiondrive_records.db.settings import RecordsSettings, SettingsError, load_settings
from exceptiondrive_records.operations.setup import opened, prepare
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.launcher.layout import Address, Layout
from exceptiondrive_server.operations.records_commands import DataOption, records_app, say
from exceptiondrive_server.operations.upkeep_commands import upkeep_app

app = typer.Typer(
    help="Run and operate an ExceptionDrive evaluation server.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.registered_commands += records_app.registered_commands
app.registered_commands += upkeep_app.registered_commands

HostOption = Annotated[str, typer.Option("--host", help="Address to listen on.")]
GrantToOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--grant-to",
        exists=True,
        dir_okay=False,
        help="File with the address that a service connects with: its role is created if need be, "
        "and given its rights. May be repeated.",
    ),
]
PortOption = Annotated[int, typer.Option("--port", min=1, max=65535, help="Port to listen on.")]


@app.command()
def run(
    port: PortOption = 8000,
    host: HostOption = "127.0.0.1",
    data: Annotated[Path, typer.Option("--data", help="Folder that keeps everything.")] = Path(
        "data"
    ),
    sample: Annotated[
        bool,
        typer.Option("--sample/--no-sample", help="Fill it with the sample split and planners."),
    ] = False,
    split: Annotated[
        Path | None,
        typer.Option("--split", help="A split file of your own: make a live phase of it."),
    ] = None,
) -> None:
    """Run everything on this machine: broker, API, worker, reconciler."""
    from exceptiondrive_server.launcher.launch import launch

    launch(data, Address(host, port), with_sample=sample, own_split=split, say=say)


@app.command()
def migrate(grant_to: GrantToOption = None, data: DataOption = None) -> None:
    """Bring the records up to date: schema and shipped protocols; run it as the database's owner."""
    url = load_settings(RecordsSettings, data).database_url
    prepare(url)
    say("the records are up to date")
    for role in grant_to_files(url, grant_to) if grant_to else []:
        say(f"{role} has its rights")


@app.command()
def roles() -> None:
    """Print the SQL that gives each database role its rights, and no more (PostgreSQL)."""
    for role in Role:
        typer.echo(f"-- {role}")
        for statement in grants(role):
            typer.echo(f"{statement};")


@app.command()
def serve(host: HostOption = "127.0.0.1", port: PortOption = 8000) -> None:
    """Serve API and pages, in one process."""
    gc.disable()  # as `__main__` does, and for the same reason
    import uvicorn

    from exceptiondrive_server.app import app_from_environment
    from exceptiondrive_server.launcher.launch import require_free_port

    require_free_port(Address(host, port))
    application = app_from_environment()
    gc.enable()
    uvicorn.run(
        application,
        host=host,
        port=port,
        forwarded_allow_ips=application.state.services.settings.trusted_proxies,
        http="httptools",  # refuses every head that two readers could read differently
        ws="none",
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=10,
    )


@app.command()
def reconcile(data: DataOption = None) -> None:
    """Wake workers for what waits, give up exhausted jobs; any number may run, one of them leads."""
    from exceptiondrive_records.notifications.channels import NoticeSettings
    from exceptiondrive_records.notifications.outbox import run_outbox
    from exceptiondrive_records.operations.garbage import run_sweeper
    from exceptiondrive_records.operations.logs import set_up_logs
    from exceptiondrive_records.operations.reconciler import run_reconciler
    from exceptiondrive_records.work.dispatch import Dispatcher

    set_up_logs(sys.stdout)
    settings = load_settings(RecordsSettings, data)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with opened(settings) as database:
        dispatcher = Dispatcher(settings.broker_url)
        outbox = threading.Thread(
            target=run_outbox,
            args=(database, load_settings(NoticeSettings, data), stop),
            name="outbox",
        )
        files = FileStore(settings.file_store_url)
        sweeper = threading.Thread(
            target=run_sweeper, args=(database, files, stop), name="sweeper", daemon=True
        )
        outbox.start()
        sweeper.start()
        try:
            run_reconciler(database, dispatcher, settings, stop)
        finally:
            stop.set()
            outbox.join()
            sweeper.join(timeout=5)  # whatever it is at is left as it should be
            dispatcher.close()


@app.command("fill-sample", hidden=True)
def fill_sample_command(
    server: Annotated[str, typer.Option("--server", help="Address of the running server.")],
    data: DataOption = None,
) -> None:
    """Register the sample split, seed, and submit the synthetic planners."""
    from exceptiondrive_server.launcher.sample import fill_sample

    layout = Layout(data if data is not None else Path("data"))
    layout.create()
    database = Database(load_settings(RecordsSettings, data).database_url)
    fill_sample(database, layout, server, say)


def main() -> None:
    """Run a command; what goes wrong is one sentence on stderr."""
    try:
        app()
        return
    except DBAPIError as error:
        said = sentence_of(error)
    except (LaunchError, RecordsError, SettingsError) as error:
        said = str(error)
    typer.echo(f"exceptiondrive-server: {said}", err=True)
    sys.exit(2)
