"""The Reminder Agent: images and the public taxonomy in, a risk record or a strategy out.

Pure parts: `image_bytes`, `prompts`, `answer_schemas`, `answers`, `completion`, `dialect`, `pace`,
`report`. Thin edges: `images` (disk), `journal` (disk), `endpoint` (network), `runner`, `cli`.
Needs the extra `exceptiondrive[agent]`; importing this package does not.
"""
