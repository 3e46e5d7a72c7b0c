"""Sign-in through an OpenID provider: code flow with PKCE, state and nonce (Authlib, joserfc).

What the provider says is believed only in a signed ID token of the expected issuer, for this
client, with the nonce of this browser's flow. Its keys are fetched again when an unknown one
appears, so that it may rotate them at any time.
"""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import httpx2
import structlog
from authlib.common.errors import AuthlibBaseError  # type: ignore[import-untyped]
from authlib.integrations.httpx_client import OAuth2Client  # type: ignore[import-untyped]
from authlib.oidc.core import CodeIDToken  # type: ignore[import-untyped]
from joserfc import jwt
from joserfc.errors import InvalidKeyIdError, JoseError
from joserfc.jwk import KeySet
from joserfc.jws import JWSRegistry

from exceptiondrive_records.accounts.people import Identity
from exceptiondrive_records.accounts.sign_in import Flow

# What the site says of its sign-in provider without speaking OpenID: a light module.
#
# `oidc` brings cryptography along; only a server that has a provider imports it.


LOOPBACK = ("127.0.0.1", "::1", "localhost")
CALLBACK = "/sign-in/callback"
"""Where the provider sends people back to, below the public address."""


class ProviderAway(Exception):  # noqa: N818 - says what happened
    """The provider does not answer, or not as a provider does."""


class SignInRefused(Exception):  # noqa: N818 - says what happened
    """The provider answered, and nobody is signed in by it."""


def is_private_url(url: str) -> bool:
    """Whether nobody on the way can read along: https, or this very machine."""
    parts = urlsplit(url)
    return parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in LOOPBACK)


SCOPE = "openid profile email"
ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512")
"""Signatures with a key pair. Never `none`, never a shared secret."""
KEEP_S = 3600.0
TIMEOUT_S = 5.0
LEEWAY_S = 60
"""How far the provider's clock may be from ours."""
_DISCOVERY = "/.well-known/openid-configuration"
_log = structlog.get_logger("exceptiondrive.oidc")


@dataclass(frozen=True)
class _Found:
    """What discovery gave."""

    metadata: Mapping[str, Any]
    keys: KeySet
    at_s: float


class Provider:
    """The one provider that this site trusts. Safe to share between threads."""

    def __init__(
        self, issuer: str, client_id: str, client_secret: str, redirect_uri: str, name: str
    ) -> None:
        self.issuer = issuer
        self.name = name
        self._client_id = client_id
        self._client_secret = client_secret
        self._redirect_uri = redirect_uri
        self._lock = threading.Lock()
        self._found: _Found | None = None

    def authorization_url(self, flow: Flow) -> str:
        """Return where to send the browser.

        Raises:
            ProviderAway: It cannot be reached.
        """
        metadata = self._discovered().metadata
        with self._client(metadata) as client:
            url, _ = client.create_authorization_url(
                metadata["authorization_endpoint"],
                state=flow.state,
                nonce=flow.nonce,
                code_verifier=flow.code_verifier,
            )
        return str(url)

    def identity(self, code: str, flow: Flow) -> Identity:
        """Return who signed in.

        Args:
            code: What the browser brought back; good for one exchange.
            flow: The one that this browser began.

        Raises:
            ProviderAway: It cannot be reached.
            SignInRefused: The code, or the ID token that it gave, is not good.
        """
        found = self._discovered()
        token = self._exchange(found.metadata, code, flow)
        claims = self._claims(found, str(token.get("id_token", "")), flow.nonce, token)
        profile = claims if claims.get("name") else {**claims, **self._userinfo(found, token)}
        if profile.get("sub") != claims["sub"]:
            raise _refused("userinfo of another subject")
        return Identity(
            issuer=self.issuer,
            subject=str(claims["sub"]),
            name=_first_text(profile, "name", "preferred_username", "nickname"),
            email=_first_text(profile, "email"),
        )

    def _client(self, metadata: Mapping[str, Any]) -> Any:
        offered = metadata.get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
        method = "client_secret_basic" if "client_secret_basic" in offered else "client_secret_post"
        return OAuth2Client(
            client_id=self._client_id,
            client_secret=self._client_secret,
            token_endpoint_auth_method=method if self._client_secret else "none",
            scope=SCOPE,
            redirect_uri=self._redirect_uri,
            code_challenge_method="S256",
            timeout=TIMEOUT_S,
            follow_redirects=False,
        )

    def _exchange(self, metadata: Mapping[str, Any], code: str, flow: Flow) -> Mapping[str, Any]:
        try:
            with self._client(metadata) as client:
                token: Mapping[str, Any] = client.fetch_token(
                    metadata["token_endpoint"], code=code, code_verifier=flow.code_verifier
                )
                return token
        except AuthlibBaseError as error:
            raise _refused(f"the code was not taken ({error.error})") from None
        except (httpx2.HTTPError, ValueError) as error:
            raise _away(error) from None

    def _claims(
        self, found: _Found, id_token: str, nonce: str, token: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return what a good ID token says; unknown keys are looked for once more."""
        try:
            try:
                signed = jwt.decode(id_token, found.keys, registry=_registry(found.metadata))
            except InvalidKeyIdError:
                found = self._discover()
                signed = jwt.decode(id_token, found.keys, registry=_registry(found.metadata))
            claims = CodeIDToken(
                signed.claims,
                signed.header,
                {"iss": {"values": [self.issuer]}, "aud": {"value": self._client_id}},
                {
                    "nonce": nonce,
                    "client_id": self._client_id,
                    "access_token": token.get("access_token"),
                },
            )
            claims.validate(leeway=LEEWAY_S)
        except (JoseError, ValueError, TypeError) as error:
            raise _refused(f"the ID token is not good ({type(error).__name__})") from None
        return dict(claims)

    def _userinfo(self, found: _Found, token: Mapping[str, Any]) -> dict[str, Any]:
        """Return the profile that some providers keep apart; {} if there is none."""
        url = found.metadata.get("userinfo_endpoint")
        if not url or not token.get("access_token"):
            return {}
        headers = {"Authorization": f"Bearer {token['access_token']}"}
        return _get_json(str(url), headers)

    def _discovered(self) -> _Found:
        found = self._found
        if found is None or time.monotonic() > found.at_s + KEEP_S:
            found = self._discover()
        return found

    def _discover(self) -> _Found:
        """Ask the provider who it is, and for its keys."""
        with self._lock:
            metadata = _get_json(self.issuer.rstrip("/") + _DISCOVERY)
            if metadata.get("issuer") != self.issuer:
                _log.error("the provider names another issuer than the settings")
                raise ProviderAway
            for name in ("authorization_endpoint", "token_endpoint", "jwks_uri"):
                if not is_private_url(str(metadata.get(name, ""))):
                    _log.error("the provider lacks an https address", name=name)
                    raise ProviderAway
            try:
                keys = KeySet.import_key_set(_get_json(str(metadata["jwks_uri"])))  # type: ignore[arg-type]
            except (JoseError, ValueError, TypeError, KeyError) as error:
                raise _away(error) from None
            self._found = _Found(metadata, keys, time.monotonic())
            return self._found


def _registry(metadata: Mapping[str, Any]) -> JWSRegistry:
    offered = metadata.get("id_token_signing_alg_values_supported", ["RS256"])
    return JWSRegistry(algorithms=[name for name in ALGORITHMS if name in offered])


def _get_json(url: str, headers: Mapping[str, str] | None = None) -> dict[str, Any]:
    try:
        answer = httpx2.get(url, headers=headers, timeout=TIMEOUT_S, follow_redirects=False)
        answer.raise_for_status()
        document = answer.json()
    except (httpx2.HTTPError, ValueError) as error:
        raise _away(error) from None
    if not isinstance(document, dict):
        raise _away(TypeError())
    return document


def _first_text(claims: Mapping[str, Any], *names: str) -> str | None:
    found = (claims.get(name) for name in names)
    return next((text for text in found if isinstance(text, str) and text.strip()), None)


def _away(error: Exception) -> ProviderAway:
    _log.warning("the sign-in provider does not answer", kind=type(error).__name__)
    return ProviderAway()


def _refused(why: str) -> SignInRefused:
    _log.warning("a sign-in through the provider was refused", why=why)
    return SignInRefused()
