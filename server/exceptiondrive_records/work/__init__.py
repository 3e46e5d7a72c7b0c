"""Work to be done: one table, one lease, and how a worker is woken for it."""
