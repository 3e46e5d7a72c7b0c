"""Who may do what: people, tokens, sessions, sign-in."""
