"""The making of a split: from driving scenes to a frozen file of regions and its datasheet.

Each candidate, one keyframe and one task, walks through stages. Every decision is an appended
record; what is true now is read from the records, and freezing is a pure function of them. All of
it lives in a workshop folder on an organizer's machine and never on a server: it holds withheld
regions. Needs the extra `exceptiondrive-worker[build]`.
"""
