"""What organizers do with teams in a season: conduct, own limits, terms, messages, names."""
