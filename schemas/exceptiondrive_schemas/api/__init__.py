"""Requests and answers of the API; documents that are stored as files are one folder up."""
