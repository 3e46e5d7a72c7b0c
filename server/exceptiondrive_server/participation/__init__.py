"""What organizers do with teams, by page and by API; what teams accept and readers are told."""
