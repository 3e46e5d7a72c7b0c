"""Operating the system: checks, backups, the overview."""
