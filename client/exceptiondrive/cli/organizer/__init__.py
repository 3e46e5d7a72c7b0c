"""Commands for organizers: `exceptiondrive organizer ...`."""
