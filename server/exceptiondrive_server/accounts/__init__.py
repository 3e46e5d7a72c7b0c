"""Authentication and authorization: people, tokens, sessions, sign-in."""
