"""Notifications to teams, and the channels that deliver them."""
