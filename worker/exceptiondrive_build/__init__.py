"""Building a split: from driving scenes to a frozen file of regions and its datasheet.

Each candidate, one keyframe and one task, passes through stages. Every decision is an appended
record; the present state is derived from the records, and freezing is a pure function of them. All
of it is in a workshop folder on an organizer's machine and never on a server: it holds withheld
regions. Needs the extra `exceptiondrive-worker[build]`.
"""
