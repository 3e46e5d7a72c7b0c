"""Managing teams, by page and API; terms that teams accept; public notes on disqualifications."""
