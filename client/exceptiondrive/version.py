"""The version of the client, and of server and worker, which ask for the very same."""

__version__ = "0.1.0"
