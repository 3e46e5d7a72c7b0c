"""Assigns cards to reviewers, and takes their decisions.

There are two queues. `inspect`: does this edit show what it should; one person a card. `verify`: is
this the region; two people who are blind to each other, and a third who sees both if they differ.
"""

import math
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from exceptiondrive_build.agreement import outcome, readings_left
from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.errors import BuildError
from exceptiondrive_build.inspection import to_inspect
from exceptiondrive_build.records import Author, Kind, Record, now_text, person_key, standing
from exceptiondrive_build.review_page.leases import Holder, Leases
from exceptiondrive_build.review_page.region import region_faults
from exceptiondrive_build.values import Checked, Inspected, Verified
from exceptiondrive_build.workshop import RECORDS, Workshop

Queue = Literal["inspect", "verify"]
KINDS: Mapping[Queue, Kind] = {"inspect": Kind.INSPECT, "verify": Kind.VERIFY}
WALK_EVERY_S, WALK_WHEN_IDLE_S = 60.0, 5.0
"""Maximum age of the known stage results: while there are cards, and if a reviewer has none."""


class TakenError(Exception):
    """Somebody else got the card while a browser was away; its decision is not needed."""


@dataclass(frozen=True)
class Progress:
    """Progress of a queue.

    Attributes:
        cards: All cards.
        decided: Cards that need nobody any more.
        mine: Standing decisions of this reviewer.
        for_me: Waiting cards that this reviewer may decide.
        for_others: Waiting cards that this reviewer has read already.
        third: Of all waiting cards, those on which two readers differ.
    """

    cards: int
    decided: int
    mine: int
    for_me: int
    for_others: int
    third: int


class Desk:
    """All cards of one workshop; queries after each decision are cheap."""

    def __init__(self, workshop: Workshop, lease_s: float) -> None:
        """Read the records once.

        Raises:
            BuildError: They cannot be read.
        """
        self.workshop = workshop
        self.leases = Leases(workshop.folder / RECORDS, lease_s)
        self._shown: dict[tuple[str, Queue, str], tuple[str, ...]] = {}
        self._skipped: dict[str, list[tuple[Queue, str]]] = defaultdict(list)
        self._of_people: dict[tuple[Kind, str], list[Record]] = defaultdict(list)
        self._standing: dict[tuple[Queue, str], tuple[Record, ...]] = {}
        self._last_id = 0
        self._walked_at, self._is_stale = -math.inf, True
        self.candidates: dict[str, Candidate] = {}
        self.why: dict[str, str] = {}
        self.refresh()

    def refresh(self, walk_after_s: float = WALK_EVERY_S) -> None:
        """Read what others appended and settings that changed; stages may run meanwhile.

        New results of stages are evaluated if the last evaluation is `walk_after_s` old.

        Raises:
            BuildError: Records, settings, prompts or scenes cannot be read.
        """
        if self.workshop.read_changes():
            self._walked_at, self._is_stale = -math.inf, True
        for record in self.workshop.records.read(after=self._last_id):
            self._last_id = record.id or self._last_id
            if record.kind in KINDS.values():
                self._of_people[record.kind, record.candidate].append(record)
                for queue in KINDS:
                    self._standing.pop((queue, record.candidate), None)
            else:
                self._is_stale = True
        if self._is_stale and time.monotonic() - self._walked_at > walk_after_s:
            self.candidates = walk(self.workshop)
            self.why = to_inspect(self.candidates, self.workshop.settings.inspect)
            self._walked_at, self._is_stale = time.monotonic(), False
            self._standing.clear()

    def cards(self, queue: Queue) -> list[str]:
        """Return the sample ids of a queue, decided ones too, in display order."""
        if queue == "inspect":
            return list(self.why)
        return [
            sample_id
            for sample_id, candidate in self.candidates.items()
            if candidate.localized is not None
            and candidate.withdrawn is None
            and self._is_accepted(sample_id)
        ]

    def standing(self, queue: Queue, sample_id: str) -> tuple[Record, ...]:
        """Return the decisions on a card's pictures that were not taken back, oldest first."""
        if (queue, sample_id) not in self._standing:
            records = standing(self._of_people.get((KINDS[queue], sample_id), ()))
            pictures = self.candidates[sample_id].pictures
            self._standing[queue, sample_id] = tuple(
                record for record in records.get(sample_id, ()) if record.inputs == pictures
            )
        return self._standing[queue, sample_id]

    def is_third(self, sample_id: str) -> bool:
        """Whether two readers of a region differ, and no third one has decided."""
        found = outcome(self.standing("verify", sample_id), self.workshop.settings.verify)
        return found.state == "third"

    def seats(self, queue: Queue, sample_id: str) -> int:
        """Return how many people a card still needs."""
        records = self.standing(queue, sample_id)
        if queue == "inspect":
            return 0 if records else 1
        return readings_left(records, self.workshop.settings.verify)

    def may_decide(self, queue: Queue, sample_id: str, reviewer: str) -> bool:
        """Whether a card needs somebody, and this person may still decide it."""
        if self.seats(queue, sample_id) == 0 or self.own(queue, sample_id, reviewer):
            return False
        is_blind = queue == "verify" and not self.is_third(sample_id)
        return not (is_blind and self._knows_others(sample_id, reviewer))

    def _knows_others(self, sample_id: str, reviewer: str) -> bool:
        """Whether a person saw others' decisions on a region, and so no longer reads it blind."""
        return any(
            record.value is not None
            and not record.value["blind"]
            and person_key(record.by.person) == person_key(reviewer)
            for record in self._of_people.get((Kind.VERIFY, sample_id), ())
        )

    def own(self, queue: Queue, sample_id: str, reviewer: str) -> Record | None:
        """Return a person's standing decision on a card; no third reader's on outdated readings."""
        key = person_key(reviewer)
        mine = [r for r in self.standing(queue, sample_id) if person_key(r.by.person) == key]
        if queue == "verify" and self.is_third(sample_id):
            mine = [r for r in mine if r.value is not None and r.value["blind"]]
        return mine[-1] if mine else None

    def claim(self, queue: Queue, holder: Holder, count: int) -> list[str]:
        """Assign cards to a browser; those that it skipped come last.

        Raises:
            BuildError: The leases cannot be written.
        """
        self.refresh()
        skipped = [card for name, card in self._skipped[holder.browser] if name == queue]

        def offered(held: dict[str, list[Holder]]) -> Iterator[str]:
            waiting = [card for card in self.cards(queue) if card not in skipped]
            for card in [*waiting, *skipped]:
                people = held.get(card, [])
                if (
                    self.may_decide(queue, card, holder.reviewer)
                    and len(people) < self.seats(queue, card)
                    and person_key(holder.reviewer)
                    not in {person_key(it.reviewer) for it in people}
                ):
                    yield card

        taken = self.leases.claim(queue, holder, count, offered)
        if not taken and count and self._is_stale:
            self.refresh(WALK_WHEN_IDLE_S)
            taken = self.leases.claim(queue, holder, count, offered)
        self._show(queue, holder, taken)
        return taken

    def skip(self, queue: Queue, sample_id: str, holder: Holder) -> None:
        """Release a card, and show it to this browser last."""
        if (queue, sample_id) in self._skipped[holder.browser]:
            self._skipped[holder.browser].remove((queue, sample_id))
        self._skipped[holder.browser].append((queue, sample_id))
        self.leases.give_back(holder, queue, sample_id)

    def decide(
        self,
        queue: Queue,
        sample_id: str,
        holder: Holder,
        value: Inspected | Verified,
    ) -> None:
        """Append a decision and release the card.

        Idempotent: repeating a decision, as after a lost answer, adds none. `blind` says how the
        card of a verification was shown.

        Raises:
            BuildError: It cannot be stored, the region cannot be scored, nothing of it was checked,
                or another decision of this person stands.
            TakenError: The card was given to somebody else meanwhile, its readings changed, or its
                pictures are not those that this browser was shown.
        """
        self.refresh()
        if sample_id not in self.candidates:
            raise TakenError
        pictures = self.candidates[sample_id].pictures
        if (
            not pictures
            or self._shown.get((holder.browser, queue, sample_id), pictures) != pictures
        ):
            self.leases.give_back(holder, queue, sample_id)
            raise TakenError
        if isinstance(value, Verified):
            faults = region_faults(value.corners, self.workshop.protocol) if value.accepted else ()
            if faults:
                raise BuildError(f"This region cannot be scored: {'; '.join(faults)}.")
            if value.accepted and not value.checked:
                raise BuildError(f"Say what you checked: {', '.join(get_args(Checked))}.")
        own = self.own(queue, sample_id, holder.reviewer)
        told = value.model_dump(mode="json")
        if own is not None:
            if own.value == told:
                return
            raise BuildError("Your first word on this card was kept.", "U takes it back.")
        if isinstance(value, Verified) and (
            value.blind == self.is_third(sample_id)
            or (value.blind and self._knows_others(sample_id, holder.reviewer))
        ):
            self.leases.give_back(holder, queue, sample_id)
            raise TakenError
        if not self.leases.holds(queue, sample_id, holder) and not self._take(
            queue, sample_id, holder
        ):
            raise TakenError
        self.workshop.records.append(
            Record(
                kind=KINDS[queue],
                candidate=sample_id,
                by=Author(person=holder.reviewer),
                inputs=pictures,
                value=told,
            )
        )
        self.leases.give_back(holder, queue, sample_id)
        self.refresh()

    def undo(self, queue: Queue, holder: Holder) -> tuple[str, Record] | None:
        """Take back this person's newest decision and claim its card; None if there is none.

        Raises:
            BuildError: It cannot be stored.
        """
        self.refresh()
        mine = [
            (own, card)
            for card in self.cards(queue)
            if (own := self.own(queue, card, holder.reviewer)) is not None
        ]
        if not mine:
            return None
        own, card = max(mine, key=lambda found: found[0].id or 0)
        self.workshop.records.append(
            own.model_copy(
                update={"value": None, "supersedes": own.id, "at": now_text(), "id": None}
            )
        )
        self.refresh()
        self.leases.claim(queue, holder, 1, lambda _: iter([card]))
        self._show(queue, holder, [card])
        return card, own

    def progress(self, queue: Queue, reviewer: str) -> Progress:
        """Return the progress of a queue for one person."""
        self.refresh()
        cards = self.cards(queue)
        waiting = [card for card in cards if self.seats(queue, card)]
        for_me = sum(self.may_decide(queue, card, reviewer) for card in waiting)
        return Progress(
            cards=len(cards),
            decided=len(cards) - len(waiting),
            mine=sum(self.own(queue, card, reviewer) is not None for card in cards),
            for_me=for_me,
            for_others=len(waiting) - for_me,
            third=sum(self.is_third(card) for card in waiting) if queue == "verify" else 0,
        )

    def _show(self, queue: Queue, holder: Holder, cards: Iterable[str]) -> None:
        """Remember which pictures a browser is shown: its decision is about these alone."""
        for card in cards:
            self._shown[holder.browser, queue, card] = self.candidates[card].pictures

    def _take(self, queue: Queue, sample_id: str, holder: Holder) -> bool:
        """Claim one card, if nobody else has the last seat."""

        def offered(held: dict[str, list[Holder]]) -> Iterator[str]:
            others = [one for one in held.get(sample_id, []) if one.browser != holder.browser]
            if self.may_decide(queue, sample_id, holder.reviewer) and len(others) < self.seats(
                queue, sample_id
            ):
                yield sample_id

        return bool(self.leases.claim(queue, holder, 1, offered))

    def _is_accepted(self, sample_id: str) -> bool:
        """Whether the edit is good enough, by people's decisions so far."""
        words = self.standing("inspect", sample_id)
        newest = Inspected.model_validate(words[-1].value, strict=False) if words else None
        return self.candidates[sample_id].accepted_after(newest)
