"""Commands about receipts: get, verify, keys."""

from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive.checking import write_file
from exceptiondrive.cli import options
from exceptiondrive.cli.file_tables import AGGREGATES
from exceptiondrive.cli.options import argument, option
from exceptiondrive.cli.output import replacing, say, show_result
from exceptiondrive.cli.session import open_client
from exceptiondrive.errors import InvalidArgumentError, utc_text
from exceptiondrive.receipts import remember_keys, verify_receipt
from exceptiondrive_schemas.printable import printable

Output = Annotated[Path | None, options.output("Output file; else stdout.")]


def get(
    submission_id: options.SubmissionId, output: Output = None, server: options.Server = None
) -> None:
    """Fetch the signed receipt of a scored submission, or of anyone's entry on a board.

    The server's public keys are remembered on this machine, for `receipt verify`.
    """
    with open_client(server) as client:
        receipt, found = client.receipt(submission_id), client.receipt_keys()
    unwritable = None
    try:
        remember_keys(found)
    except InvalidArgumentError as error:
        if error.code != "unwritable_file":
            raise
        unwritable = error
    _write_or_print(receipt.model_dump_json(by_alias=True, indent=2), output)
    if unwritable is not None:
        say(f"warning: the keys are not remembered: {unwritable.sentence}")
        say("Keep them in a file: exceptiondrive receipt keys -o FILE")


def keys(output: Output = None, server: options.Server = None) -> None:
    """Fetch the public keys of a server's receipts."""
    with open_client(server) as client:
        found = client.receipt_keys()
    _write_or_print(found.model_dump_json(by_alias=True, indent=2), output)


def verify(
    file: Annotated[Path, argument("FILE", "A receipt.")],
    key: Annotated[
        Path | None, option("--key", "KEYFILE", "Public keys; else the remembered ones.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Check a receipt on this machine, without the server, and say which server's key signed it.

    If a field was altered, the exit code is 2 and stderr names the field.
    """
    verdict = verify_receipt(file, keys=key)
    said = verdict.receipt.statement
    servers = ", ".join(verdict.servers) or "a server that is not noted beside it"
    show_result(
        {**verdict.receipt.model_dump(mode="json", by_alias=True), "servers": [*verdict.servers]},
        json,
        f"the receipt holds: key {verdict.key.key_id} of {servers}",
        f"submission {said.submission_id} of {said.team}, file {said.file_digest}",
        f"scored {utc_text(said.scored_at)} under protocol {said.protocol.version} "
        f"({said.protocol.digest}) on {said.split.name} ({said.split.revision})",
        *(
            f"{said.n:,} samples, {words}: "
            + ", ".join(f"{key} {value}" for key, value in getattr(said, average).items())
            for average, words in AGGREGATES.items()
        ),
    )


def _write_or_print(text: str, output: Path | None) -> None:
    if output is None:
        typer.echo(printable(text))
        return
    with replacing(output):
        write_file(output, text + "\n")
    say(f"written to {output}")


receipt = {"get": get, "verify": verify, "keys": keys}
