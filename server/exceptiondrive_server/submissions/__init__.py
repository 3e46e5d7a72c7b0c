"""Submissions: uploads and their outcome."""
