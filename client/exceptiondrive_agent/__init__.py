"""The Reminder Agent: images and the public taxonomy in, a risk record or a strategy out.

Pure parts: `questions`, `report`. Thin edges: `journal` (disk), `run` (images and endpoint), `cli`.
It stands on the client, which reaches it only for its two commands.
Needs the extra `exceptiondrive[agent]`; importing this package does not.
"""
