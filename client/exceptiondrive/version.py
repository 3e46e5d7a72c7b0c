"""The version of the client, which server and worker require to be the same."""

__version__ = "0.1.0"
