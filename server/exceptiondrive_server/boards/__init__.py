"""The ranked boards: snapshots, and the pointer to the current one."""
