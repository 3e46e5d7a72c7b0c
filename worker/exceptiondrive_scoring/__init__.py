"""Scoring: pure functions on arrays. No I/O, clock, network, environment or globals.

Data flows one way: answers --measure--> measurements --grade--> sample scores --aggregate-->
breakdown --rank--> board. `challenge.scoring_of` gives the measure and grade of each challenge.
Every constant comes from the protocol document; every formula names its place in docs/protocol.md.
"""

SCORER_VERSION = "6"
"""Raised when the same input may give another number, and when a sheet gains a metric or another
field; workers then recompute what they cached. Every score sheet names its own and keeps it; the
next protocol version, with a rescoring to it, moves a whole board to the new scorer."""
