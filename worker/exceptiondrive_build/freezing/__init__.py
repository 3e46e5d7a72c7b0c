"""From the records of a workshop to a split, and to everything that is published beside it."""
