"""The variable by which the runner tells the plugin what to take away."""

NAME = "EXCEPTIONDRIVE_TAKE_AWAY"
