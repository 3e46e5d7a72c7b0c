"""Announcements by organizers, and questions from teams."""
