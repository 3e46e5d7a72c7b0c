"""Splits as the worker keeps them: read, checked, registered, published, and their floors held."""
