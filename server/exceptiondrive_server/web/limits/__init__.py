"""Limits on concurrent load: bytes of a body, slots for uploads, slots for pages."""
