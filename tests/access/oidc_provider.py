"""A real OpenID provider of one client and one person: Authlib's server, with PKCE demanded.

It runs as a process of its own (`python -m tests.access.oidc_provider PORT`). `POST /control` sets
what it does wrong next; without orders it does everything right. The packages that serve a provider
for tests check no PKCE and rotate no keys, hence this one.
"""

import os
import sys
import time
from dataclasses import dataclass, field
from typing import Any

os.environ["AUTHLIB_INSECURE_TRANSPORT"] = "1"  # loopback alone

import flask
from authlib.integrations.flask_oauth2 import (  # type: ignore[import-untyped]
    AuthorizationServer,
    ResourceProtector,
    current_token,
)
from authlib.oauth2.rfc6749 import (  # type: ignore[import-untyped]
    AuthorizationCodeMixin,
    ClientMixin,
    TokenMixin,
)
from authlib.oauth2.rfc6749.grants import (  # type: ignore[import-untyped]
    AuthorizationCodeGrant,
)
from authlib.oauth2.rfc6750 import BearerTokenValidator  # type: ignore[import-untyped]
from authlib.oauth2.rfc7636 import CodeChallenge  # type: ignore[import-untyped]
from authlib.oidc.core import UserInfo  # type: ignore[import-untyped]
from authlib.oidc.core.grants import OpenIDCode  # type: ignore[import-untyped]
from joserfc import jwt
from joserfc.jwk import OctKey, RSAKey
from joserfc.jws import JWSRegistry

CLIENT_ID = "exceptiondrive"
CLIENT_SECRET = "a-secret-of-the-client"
REDIRECT_URI = "https://server.test/sign-in/callback"


@dataclass
class Client(ClientMixin):  # type: ignore[misc]
    """The one relying party."""

    redirect_uri: str

    def get_client_id(self) -> str:
        return CLIENT_ID

    def get_default_redirect_uri(self) -> str:
        return self.redirect_uri

    def get_allowed_scope(self, scope: str) -> str:
        return scope

    def check_redirect_uri(self, redirect_uri: str) -> bool:
        return redirect_uri == self.redirect_uri

    def check_client_secret(self, client_secret: str) -> bool:
        return client_secret == CLIENT_SECRET

    def check_endpoint_auth_method(self, method: str, endpoint: str) -> bool:
        return method == "client_secret_basic"

    def check_response_type(self, response_type: str) -> bool:
        return response_type == "code"

    def check_grant_type(self, grant_type: str) -> bool:
        return grant_type == "authorization_code"


@dataclass
class Code(AuthorizationCodeMixin):  # type: ignore[misc]
    """An authorization code, good for one exchange."""

    code: str
    redirect_uri: str
    scope: str
    nonce: str
    code_challenge: str
    code_challenge_method: str
    person: dict[str, Any]

    def get_redirect_uri(self) -> str:
        return self.redirect_uri

    def get_scope(self) -> str:
        return self.scope

    def get_nonce(self) -> str:
        return self.nonce

    def get_auth_time(self) -> int:
        return int(time.time())

    def get_acr(self) -> None:
        return None

    def get_amr(self) -> None:
        return None


@dataclass
class AccessToken(TokenMixin):  # type: ignore[misc]
    """Opens the userinfo endpoint."""

    person: dict[str, Any]

    def get_scope(self) -> str:
        return "openid"

    def get_expires_in(self) -> int:
        return 600

    def is_expired(self) -> bool:
        return False

    def is_revoked(self) -> bool:
        return False


def new_key(kid: str) -> RSAKey:
    return RSAKey.generate_key(2048, {"kid": kid, "use": "sig", "alg": "RS256"})


@dataclass
class State:
    """What the provider knows, and what it was ordered to do."""

    issuer: str
    key: RSAKey = field(default_factory=lambda: new_key("first"))
    published: list[RSAKey] = field(default_factory=list)
    codes: dict[str, Code] = field(default_factory=dict)
    tokens: dict[str, AccessToken] = field(default_factory=dict)
    orders: dict[str, Any] = field(default_factory=dict)
    asked_for_keys: int = 0

    @property
    def person(self) -> dict[str, Any]:
        default = {"sub": "sub-1", "name": "Ada Example", "email": "ada@example.org"}
        person: dict[str, Any] = self.orders.get("person", default)
        return person

    def carry_out(self, orders: dict[str, Any]) -> None:
        self.orders = orders
        if orders.get("rotate"):
            self.key = new_key(orders["rotate"])
            self.published = [self.key]
        if orders.get("sign_with_unpublished"):
            self.key = new_key("nobody-knows-it")

    def spoiled(self, id_token: str) -> str:
        """Sign the ID token again as ordered."""
        claims = {**jwt.decode(id_token, self.key).claims, **self.orders.get("claims", {})}
        claims = {name: value for name, value in claims.items() if value is not None}
        algorithm = self.orders.get("algorithm", "RS256")
        keys: dict[str, OctKey | RSAKey] = {
            "RS256": self.key,
            "HS256": OctKey.import_key(CLIENT_SECRET * 2),
        }
        key = new_key("first") if self.orders.get("forge") else keys.get(algorithm, self.key)
        kid = self.key.kid if algorithm != "none" else None
        registry = JWSRegistry(algorithms=[algorithm])
        header = {"alg": algorithm, **({"kid": kid} if kid else {})}
        return jwt.encode(header, claims, key, registry=registry)


def make_app(issuer: str) -> flask.Flask:
    state = State(issuer)
    state.published = [state.key]
    app = flask.Flask("provider")
    server = AuthorizationServer(
        app,
        query_client=lambda client_id: Client(REDIRECT_URI) if client_id == CLIENT_ID else None,
        save_token=lambda token, request: state.tokens.update(
            {token["access_token"]: AccessToken(request.user)}
        ),
    )
    _register_grant(server, state)
    _add_endpoints(app, server, state)
    return app


def _register_grant(server: Any, state: State) -> None:
    class Grant(AuthorizationCodeGrant):  # type: ignore[misc]
        def save_authorization_code(self, code: str, request: Any) -> None:
            data = request.payload.data
            state.codes[code] = Code(
                code=code,
                redirect_uri=request.payload.redirect_uri,
                scope=request.payload.scope,
                nonce=data["nonce"],
                code_challenge=data["code_challenge"],
                code_challenge_method=data["code_challenge_method"],
                person=request.user,
            )

        def query_authorization_code(self, code: str, client: Client) -> Code | None:
            return state.codes.get(code)

        def delete_authorization_code(self, authorization_code: Code) -> None:
            del state.codes[authorization_code.code]

        def authenticate_user(self, authorization_code: Code) -> dict[str, Any]:
            return authorization_code.person

    class IdToken(OpenIDCode):  # type: ignore[misc]
        def exists_nonce(self, nonce: str, request: Any) -> bool:
            return any(code.nonce == nonce for code in state.codes.values())

        def get_jwt_config(self, grant: Any, client: Client) -> dict[str, Any]:
            return {"key": state.key, "alg": "RS256", "iss": state.issuer, "exp": 600}

        def generate_user_info(self, user: dict[str, Any], scope: str) -> Any:
            kept = state.orders.get("id_token_names", list(user))
            return UserInfo({name: user[name] for name in ("sub", *kept)})

        def get_audiences(self, request: Any) -> list[str]:
            return [CLIENT_ID]

    server.register_grant(Grant, [IdToken(require_nonce=True), CodeChallenge(required=True)])


def _add_endpoints(app: flask.Flask, server: Any, state: State) -> None:
    class Validator(BearerTokenValidator):  # type: ignore[misc]
        def authenticate_token(self, token_string: str) -> AccessToken | None:
            return state.tokens.get(token_string)

    protector = ResourceProtector()
    protector.register_token_validator(Validator())

    @app.get("/.well-known/openid-configuration")
    def discovery() -> Any:
        named = state.orders.get("names_itself", state.issuer)
        return {
            "issuer": named,
            "authorization_endpoint": f"{state.issuer}/authorize",
            "token_endpoint": f"{state.issuer}/token",
            "jwks_uri": f"{state.issuer}/keys",
            "userinfo_endpoint": state.orders.get("userinfo_at", f"{state.issuer}/userinfo"),
            "response_types_supported": ["code"],
            "subject_types_supported": ["public"],
            "id_token_signing_alg_values_supported": ["RS256", "HS256", "none"],
            "token_endpoint_auth_methods_supported": ["client_secret_basic"],
            "code_challenge_methods_supported": ["S256"],
        }

    @app.get("/keys")
    def keys() -> Any:
        state.asked_for_keys += 1
        return {"keys": [key.as_dict(private=False) for key in state.published]}

    @app.get("/authorize")
    def authorize() -> Any:
        grant = server.get_consent_grant(end_user=state.person)
        if state.orders.get("deny"):
            return server.create_authorization_response(grant_user=None, grant=grant)
        return server.create_authorization_response(grant_user=state.person, grant=grant)

    @app.post("/token")
    def token() -> Any:
        answer = server.create_token_response()
        if answer.status_code == 200:
            document = answer.get_json()
            document["id_token"] = state.spoiled(document["id_token"])
            answer.set_data(flask.json.dumps(document))
        return answer

    @app.get("/userinfo")
    @protector()  # type: ignore[untyped-decorator]
    def userinfo() -> Any:
        if "userinfo_answers" in state.orders:
            return tuple(state.orders["userinfo_answers"])
        return {**current_token.person, **state.orders.get("userinfo", {})}

    @app.post("/control")
    def control() -> Any:
        state.carry_out(flask.request.get_json())
        return {"asked_for_keys": state.asked_for_keys}


if __name__ == "__main__":
    port = int(sys.argv[1])
    make_app(f"http://127.0.0.1:{port}").run("127.0.0.1", port, threaded=True)
