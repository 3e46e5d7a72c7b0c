"""Teams and how they come to be."""
