"""Protocol updates: runs, preview, apply, rollback."""
