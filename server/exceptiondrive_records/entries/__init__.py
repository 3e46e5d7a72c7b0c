"""The choices of teams about their entries on boards."""
