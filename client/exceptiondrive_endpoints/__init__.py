"""One client for OpenAI-compatible endpoints: chat with pictures, and edits of pictures.

The Reminder Agent and the making of splits ask models through it, so both survive the same
failures. It stands on schemas alone. Needs openai (extras `agent` and `build`); importing `errors`,
`images`, `answers` or `journal` does not.
"""
