"""The page on which people inspect edits and verify regions; it is served on loopback only."""
