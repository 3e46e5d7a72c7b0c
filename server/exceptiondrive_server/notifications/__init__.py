"""What teams are told, and by which channel."""
