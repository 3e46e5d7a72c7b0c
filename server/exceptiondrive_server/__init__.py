"""The web server: the API and pages of the leaderboard."""
