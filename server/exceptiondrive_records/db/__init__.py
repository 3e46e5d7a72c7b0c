"""The database under all nouns: base, session, columns, roles."""
