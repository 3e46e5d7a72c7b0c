"""The embedded default: everything on one machine, nothing to install (`exceptiondrive-server run`)."""
