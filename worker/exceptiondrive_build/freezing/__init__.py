"""From the records of a workshop to a split, and to all that is published beside it."""
