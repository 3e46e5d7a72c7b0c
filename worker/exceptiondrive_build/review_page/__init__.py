"""The page on which people look at edits and verify regions; it answers on the loopback alone."""
