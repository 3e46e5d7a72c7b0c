"""The work queue: one table, one lease, and how workers are woken."""
