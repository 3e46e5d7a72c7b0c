"""What was just done, in words: addresses carry a key, never a text of their own."""

from collections.abc import Mapping
from types import MappingProxyType

DONE: Mapping[str, str] = MappingProxyType(
    {
        "team_created": "The team is created. Issue its first token below, and hand it over.",
        "team_approved": "The team is approved: it may submit.",
        "team_refused": "The registration is refused. The team and its tokens are gone.",
        "token_revoked": "The token is revoked. It no longer works.",
        "phase_created": "The phase is created.",
        "phase_changed": "The phase is changed; the audit log says from what to what.",
        "submission_retried": "The submission is queued again, with all its attempts.",
        "protocol_added": "The protocol is added. No score changes until you rescore with it.",
        "protocol_known": "This very document is there already. Nothing was added.",
        "run_drafted": "The run is drafted. Nothing is scored until you start it.",
        "run_started": "Scoring has begun, behind fresh submissions.",
        "run_paused": "The run is paused: no further sheet begins.",
        "run_resumed": "The run goes on, and failed sheets are tried again.",
        "run_cancelled": "The run is cancelled. The public board never changed.",
        "run_applied": "Applied: readers see the new board from now on.",
        "run_rolled_back": "Rolled back: readers see the earlier protocol's board again.",
        "run_closed": "The run is closed: the new protocol stays.",
        "verification_started": "Workers recompute the sheets from their uploads.",
    }
)
