"""What organizers announce, and what teams ask them."""
