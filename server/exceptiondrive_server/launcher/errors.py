"""Why the launcher does not start."""


class LaunchError(Exception):
    """The launcher cannot go on; `str()` says why and what to do."""
