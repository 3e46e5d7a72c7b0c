"""What the site says of its sign-in provider without speaking OpenID: a light module.

`oidc` brings cryptography along; only a server that has a provider imports it.
"""

CALLBACK = "/sign-in/callback"
"""Where the provider sends people back to, below the public address."""


class ProviderAway(Exception):  # noqa: N818 - says what happened
    """The provider does not answer, or not as a provider does."""


class SignInRefused(Exception):  # noqa: N818 - says what happened
    """The provider answered, and nobody is signed in by it."""
