"""Teams and their registration."""
