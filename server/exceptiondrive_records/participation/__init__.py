"""Managing teams during a season: disqualification, allowances, terms, messages, names."""
