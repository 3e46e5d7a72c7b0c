"""The database: its connection, clock, column types, and the base of all tables."""
