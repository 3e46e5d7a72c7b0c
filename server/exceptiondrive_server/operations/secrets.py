"""Create the secrets of a production server: every file that compose.yaml names, in one go.

Passwords are generated here and shown to nobody. Values shared by several files agree.
"""

import ipaddress
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import NameOID

from exceptiondrive_records.db.roles import Role
from exceptiondrive_server.launcher.child import LaunchError
from exceptiondrive_server.submissions.receipts import new_key_pem

# A certificate that signs itself: the first of a server, and that of tests.


LIFETIME = timedelta(days=90)


def self_signed(host: str) -> tuple[bytes, bytes]:
    """Return certificate and key (PEM) for a host name or an IP address, good for 90 days."""
    key = generate_private_key(SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, host[:64])])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))  # a clock may be slow
        .not_valid_after(now + LIFETIME)
        .add_extension(x509.SubjectAlternativeName([_general_name(host)]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, SHA256())
    )
    return (
        certificate.public_bytes(Encoding.PEM),
        key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()),
    )


def require_pair(folder: Path) -> datetime:
    """Refuse a certificate beside another one's key: nginx takes both, and then nobody gets in.

    Returns:
        When the certificate ends, or ended.

    Raises:
        LaunchError: They do not belong together, or one cannot be read.
    """
    certificate, key = folder / "tls.crt", folder / "tls.key"
    try:
        read = x509.load_pem_x509_certificate(certificate.read_bytes())
        of_key = load_pem_private_key(key.read_bytes(), password=None).public_key()
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise LaunchError(
            f"{certificate} or {key} cannot be read: PEM is wanted, and a key without a password; what is "
            "in use stays"
        ) from None
    if read.public_key() != of_key:
        raise LaunchError(f"{key} is not the key of {certificate}; what is in use stays")
    return read.not_valid_after_utc


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


RECEIPT_KEY = "receipt_key.pem"
DATABASE = "exceptiondrive"
OWNER = "exceptiondrive_owner"
_PASSWORD_BYTES = 24
_MADE_TOGETHER = (
    {"postgres_password", "owner_database_url"},
    {"broker_url", "broker.conf"},
    {"tls.crt", "tls.key"},
)


def write_first_secrets(
    folder: Path, host: str, *, database: str = "database", broker: str = "broker:6379"
) -> list[Path]:
    """Write every file that the folder does not hold yet, and return those.

    The folder is for its owner alone; the files in it may be read by whoever gets one mounted.
    `host` is for a certificate that signs itself until there is a real one. Database and broker
    stand where the services know them, by default as in compose.yaml.

    Raises:
        LaunchError: One of two files that agree is there and the other is not: nothing was written.
    """
    files = _files(host, database, broker)
    missing = [name for name, content in files.items() if _is_missing(folder / name, content)]
    for pair in _MADE_TOGETHER:
        if len(lacking := pair & set(missing)) == 1:
            raise LaunchError(
                f"{folder} holds {', '.join(pair - lacking)} and no {', '.join(lacking)}, which agrees "
                "with it; nothing was written. Put the missing one back, or take both away; see "
                "`rotate keys` in docs/operating.md."
            )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.chmod(0o700)
    for name in missing:
        (folder / name).write_bytes(files[name])
        (folder / name).chmod(0o644)
    return [folder / name for name in missing]


def _is_missing(path: Path, content: bytes) -> bool:
    """Whether there is no such file, or an empty one that should not be: a full disk leaves some."""
    return not path.exists() or (path.stat().st_size == 0 and content != b"")


def _files(host: str, database: str, broker: str) -> Mapping[str, bytes]:
    password, owner = _password(), _password()
    certificate, key = self_signed(host)
    texts = {
        "postgres_password": owner,
        "owner_database_url": _address(OWNER, owner, database),
        "database_url": _address(Role.API, _password(), database),
        "worker_database_url": _address(Role.WORKER, _password(), database),
        "reconciler_database_url": _address(Role.RECONCILER, _password(), database),
        "broker_url": f"redis://:{password}@{broker}/0",
        "broker.conf": f"requirepass {password}\n",
        "oidc_client_secret": "",
        "smtp_password": "",
    }
    encoded = {name: text.encode() for name, text in texts.items()}
    return {**encoded, "tls.crt": certificate, "tls.key": key, RECEIPT_KEY: new_key_pem()}


def _password() -> str:
    """Return letters, digits, - and _: nothing that an address or a shell reads otherwise."""
    return secrets.token_urlsafe(_PASSWORD_BYTES)


def _address(user: str, password: str, host: str) -> str:
    return f"postgresql+psycopg://{user}:{password}@{host}/{DATABASE}"
