"""What pages say about the sign-in provider, without importing OpenID support.

`oidc` imports cryptography, so only a server with a provider loads it.
"""

CALLBACK = "/sign-in/callback"
"""Where the provider sends people back to, below the public address."""


class ProviderAway(Exception):  # noqa: N818 - says what happened
    """The provider does not answer, or not correctly."""


class SignInRefused(Exception):  # noqa: N818 - says what happened
    """The provider answered, but signed nobody in."""
