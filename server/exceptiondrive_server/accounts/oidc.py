"""Sign-in through an OpenID provider: code flow with PKCE, state and nonce, by Authlib.

The state of a flow is kept in a signed cookie of the browser that began it, for `FLOW_S`. Claims are
trusted only in a signed ID token of the expected issuer, for this client, with the nonce of this
flow. The provider's keys are fetched again when an unknown one appears, so that it may rotate them
at any time.
"""

import hashlib
import json
import secrets
import time
from collections.abc import Mapping
from typing import Any

import httpx2
import structlog
from authlib.common.errors import AuthlibBaseError  # type: ignore[import-untyped]
from authlib.integrations.starlette_client import (  # type: ignore[import-untyped]
    OAuth,
    StarletteIntegration,
)
from joserfc.errors import JoseError
from joserfc.jwk import KeySet
from starlette.applications import Starlette
from starlette.middleware.sessions import SessionMiddleware
from starlette.requests import Request

from exceptiondrive_records.accounts.people import Identity
from exceptiondrive_server.accounts.sign_in_provider import CALLBACK, ProviderAway, SignInRefused
from exceptiondrive_server.submissions.receipts import read_or_make_key
from exceptiondrive_server.web.settings import ServerSettings, is_private_url

ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512")
"""Signatures with a key pair. Never `none`, never a shared secret."""
KEEP_S = 3600.0
TIMEOUT_S = 5.0
LEEWAY_S = 60
"""How far the provider's clock may be from ours."""
FLOW_S = 600
"""How long somebody may take at the provider."""
ERRORS = frozenset({
    "invalid_request", "unauthorized_client", "unsupported_response_type", "invalid_scope",
    "server_error", "temporarily_unavailable", "invalid_client", "invalid_grant",
    "unsupported_grant_type", "interaction_required", "login_required",
    "account_selection_required", "consent_required",
})  # fmt: skip
"""Of RFC 6749 and OpenID Connect: of what else a provider answers, logs hold nothing."""
_DISCOVERY = "/.well-known/openid-configuration"
_ENDPOINTS = ("authorization_endpoint", "token_endpoint", "jwks_uri")
_log = structlog.get_logger("exceptiondrive.oidc")


class Provider:
    """The OpenID provider that this site trusts."""

    def __init__(self, settings: ServerSettings) -> None:
        self.issuer = settings.oidc_issuer
        self.name = settings.oidc_name
        self._redirect_uri = settings.public_url.rstrip("/") + CALLBACK
        self._registered: Mapping[str, Any] = {
            "client_id": settings.oidc_client_id,
            "client_secret": settings.oidc_client_secret.get_secret_value() or None,
            "server_metadata_url": self.issuer.rstrip("/") + _DISCOVERY,
        }
        self._flows = StarletteIntegration("provider")
        self._flow_key = _flow_key(settings)
        self._client: Any = None
        self._client_at_s = 0.0

    def keep_flows(self, app: Starlette) -> None:
        """Let the application keep flows under way in a signed cookie."""
        is_https = self._redirect_uri.startswith("https://")
        app.add_middleware(
            SessionMiddleware,
            secret_key=self._flow_key,
            session_cookie="__Host-sign-in" if is_https else "sign-in",
            max_age=None,  # else a server whose clock is behind that of the one that signed reads nothing
            https_only=is_https,
        )

    async def begin(self, request: Request, back: str) -> str:
        """Return where to send the browser; what comes back must fit what its cookie now holds.

        It goes on to `back` afterwards.

        Raises:
            ProviderAway: It cannot be reached.
        """
        client = await self._provider_client()
        state, nonce = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        flow = await client.create_authorization_url(self._redirect_uri, state=state, nonce=nonce)
        url = str(flow.pop("url"))
        await client.save_authorize_data(
            request,
            redirect_uri=self._redirect_uri,
            back=back,
            until_s=time.time() + FLOW_S,
            **flow,
        )
        return url

    async def way_back(self, request: Request) -> str | None:
        """Return the page that a flow of this browser leads to; None if it began none such, or long ago."""
        state = request.query_params.get("state", "")
        flow = await self._flows.get_state_data(request.session, state)
        is_under_way = flow is not None and time.time() < flow.get("until_s", 0)
        return str(flow["back"]) if is_under_way else None

    async def identity(self, request: Request) -> Identity:
        """Return who came back from the provider; whatever comes of it, the flow has ended.

        Raises:
            ProviderAway: It cannot be reached.
            SignInRefused: It declined, or the code or the ID token that it gave is not good.
        """
        try:
            client = await self._provider_client()
            if request.query_params.get("iss", self.issuer) != self.issuer:  # RFC 9207
                raise _sign_in_refused("the answer of another provider")
            token = await client.authorize_access_token(
                request,
                claims_options={
                    "iss": {"values": [self.issuer]},
                    "aud": {"value": self._registered["client_id"]},
                },
                leeway=LEEWAY_S,
            )
            claims = token.get("userinfo") or {}
            has_all = claims.get("name") and claims.get("email")
            profile = claims if has_all else await _with_profile(client, token, claims)
        except AuthlibBaseError as error:
            code = error.error if error.error in ERRORS else "another error"
            raise _sign_in_refused(f"the provider answered {code}") from None
        except (httpx2.HTTPError, json.JSONDecodeError) as error:
            raise _provider_away(error) from None
        except (JoseError, ValueError, TypeError) as error:
            self._client = None  # its keys may be new under an old name: who begins again asks
            raise _sign_in_refused(f"the ID token is not good ({type(error).__name__})") from None
        finally:
            request.session.clear()
        if "sub" not in claims or profile.get("sub") != claims["sub"]:
            raise _sign_in_refused("no ID token, or userinfo of another subject")
        return Identity(
            issuer=self.issuer,
            subject=str(claims["sub"]),
            name=_first_text(profile, "name", "preferred_username", "nickname"),
            email=_first_text(profile, "email") if _may_be_theirs(profile) else None,
        )

    async def _provider_client(self) -> Any:
        if self._client is None or time.monotonic() > self._client_at_s + KEEP_S:
            self._client = await self._discover()
            self._client_at_s = time.monotonic()
        return self._client

    async def _discover(self) -> Any:
        """Ask the provider who it is, and for its keys; return Authlib's client of it."""
        client = OAuth().register(
            "provider",
            **self._registered,
            client_kwargs={
                "scope": "openid profile email",
                "code_challenge_method": "S256",
                "timeout": TIMEOUT_S,
                "follow_redirects": False,
            },
        )
        try:
            metadata = await client.load_server_metadata()
            self._check(metadata)
            KeySet.import_key_set(await client.fetch_jwk_set())
        except (httpx2.HTTPError, JoseError, ValueError, TypeError, KeyError) as error:
            raise _provider_away(error) from None
        offered = metadata.get("id_token_signing_alg_values_supported", ["RS256"])
        allowed = [name for name in ALGORITHMS if name in offered]
        metadata["id_token_signing_alg_values_supported"] = allowed or ["RS256"]
        methods = metadata.get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
        if self._registered["client_secret"] and "client_secret_basic" not in methods:
            client.client_kwargs["token_endpoint_auth_method"] = "client_secret_post"
        return client

    def _check(self, metadata: Mapping[str, Any]) -> None:
        if metadata.get("issuer") != self.issuer:
            _log.error(
                "the provider names another issuer than EXCEPTIONDRIVE_OIDC_ISSUER",
                named=str(metadata.get("issuer"))[:200],
                expected=self.issuer,
            )
            raise ProviderAway
        for name in _ENDPOINTS:
            if not is_private_url(str(metadata.get(name, ""))):
                _log.error("the provider lacks an https address", name=name)
                raise ProviderAway


def _flow_key(settings: ServerSettings) -> str:
    """Return the key that signs the cookies of flows, the same in every server of the site."""
    secret = settings.oidc_client_secret.get_secret_value().encode()
    if not secret:  # a public client
        secret = read_or_make_key(settings.receipt_key_file).private_bytes_raw()
    return hashlib.blake2b(secret, person=b"sign-in flow").hexdigest()


async def _with_profile(
    client: Any, token: Mapping[str, Any], claims: Mapping[str, Any]
) -> dict[str, Any]:
    """Add the profile that some providers keep apart; without it the ID token is as good."""
    metadata = await client.load_server_metadata()
    if not metadata.get("userinfo_endpoint") or not token.get("access_token"):
        return dict(claims)
    try:
        return {**claims, **await client.userinfo(token=token)}
    except (httpx2.HTTPError, ValueError) as error:
        _log.warning("the sign-in provider gives no profile", kind=type(error).__name__)
        return dict(claims)


def _may_be_theirs(profile: Mapping[str, Any]) -> bool:
    """Whether the provider does not mark the address as unverified; some write the mark as text."""
    return profile.get("email_verified") not in (False, "false")


def _first_text(claims: Mapping[str, Any], *names: str) -> str | None:
    found = (claims.get(name) for name in names)
    return next((text for text in found if isinstance(text, str) and text.strip()), None)


def _provider_away(error: Exception) -> ProviderAway:
    _log.warning("the sign-in provider does not answer", kind=type(error).__name__)
    return ProviderAway()


def _sign_in_refused(why: str) -> SignInRefused:
    _log.warning("a sign-in through the provider was refused", why=why)
    return SignInRefused()
