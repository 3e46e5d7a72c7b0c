"""Scoring: pure functions on arrays. No I/O, clock, network, environment or globals.

Data flows one way: answers --measure--> measurements --grade--> sample scores --aggregate-->
breakdown --rank--> board. `challenge.SCORING` gives the measure and grade of each challenge.
Every constant comes from the protocol document; every formula names its place in docs/protocol.md.
"""

SCORER_VERSION = "6"
"""Raised when the same input may come to another number, and when a sheet gains a metric or another
field: what workers keep under the old one is then worked out anew. Every score sheet names it, and stays:
the next version of a protocol, and a rescoring to it, make all of a board by the new one."""
