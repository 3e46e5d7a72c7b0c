"""How much one sender may ask at once: bytes of a body, places for uploads, places for pages."""
