"""The Reminder Agent: images and the public taxonomy in, a risk record or a strategy out.

Pure parts: `questions`, `answers`, `report`. Thin edges: `images` and `journal` (disk), `endpoint`
(network), `run`, `cli`. It stands on the client, which reaches it only for its two commands.
Needs the extra `exceptiondrive[agent]`; importing this package does not.
"""
