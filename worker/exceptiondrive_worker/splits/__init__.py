"""Splits in the worker: reading, checks, registration, publication, and enforcement of floors."""
