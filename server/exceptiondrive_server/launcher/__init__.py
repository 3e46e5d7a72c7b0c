"""The embedded default: everything on one machine, nothing installed (`exceptiondrive-server run`)."""
