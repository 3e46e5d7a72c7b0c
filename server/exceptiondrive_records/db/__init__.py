"""The database: its connection, clock, column types, and what all tables share."""
