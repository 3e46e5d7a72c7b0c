"""Keeping the system in order: checks, backups, the overview."""
