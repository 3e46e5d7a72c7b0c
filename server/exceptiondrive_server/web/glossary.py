"""Explanations of terms on the pages, in a sentence or two each: one registry for all pop-overs."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from exceptiondrive_schemas.challenges import CHALLENGES

_DIRECTIONS = {
    "higher": "Higher is better.",
    "lower": "Lower is better.",
    None: "It describes, and never ranks.",
}


class Term(NamedTuple):
    """A term as shown on a page, and its meaning."""

    title: str
    meaning: str


def _of_metrics() -> Iterator[tuple[str, Term]]:
    """The metrics, in the words of their challenge."""
    for challenge in CHALLENGES.values():
        for metric in (*challenge.metrics, *challenge.of_controls):
            title = (
                metric.label if metric.label == metric.title else f"{metric.label}: {metric.title}"
            )
            yield metric.key, Term(title, f"{metric.meaning} {_DIRECTIONS[metric.better]}")


_WORDS = {
    "rank": Term(
        "Rank and its range",
        "The rank is by the metric that the protocol names first, then by the next; equal numbers share "
        "a rank. A range such as 1\u20133 beside it says which ranks the entry could have, given how much the scenes vary: "
        "other scenes of the same kind could have put it anywhere in there. For a withheld split it follows "
        "from the rounded intervals, so it can be wider than a comparison sample by sample would make it. "
        "Each pair is judged by itself: among many nearly equal entries, some get a range that is too "
        "narrow, and the truly best one may get a range without 1.",
    ),
    "interval": Term(
        "\u00b1 and bars",
        "How far a number moves with another draw of the scenes: in at least 95 of 100 such draws it stays "
        "within the bar of a 95 % interval. A share that no draw moves from 0 or 100 % has Wilson's interval, by "
        "the number of scenes. \u00b1 is the distance from the number to the farther end of the bar; "
        "if the other end is much nearer, \u2212 and + give both; + or \u2212 alone means that it reaches to that "
        "side only. For withheld splits, the ends are rounded outward to whole per cents.",
    ),
    "outcome": Term(
        "What happened",
        "All samples of a row, in parts that sum to 100 %. The small squares below are the hazard "
        "families; a stronger colour means a better value of the first metric.",
    ),
    "original": Term(
        "Original scene",
        "The driving scene as it was recorded, without a hazard. The paper calls it the source scene.",
    ),
    "with_hazard": Term(
        "Scene with hazard",
        "The same scene after a hazard was added to its pictures: a child on the road, a closed lane, "
        "a signal that changed. The paper calls it the edited scene.",
    ),
    "sample": Term(
        "Sample",
        "One scene and one hazard added to it. A scene can be part of several samples, each with "
        "another hazard.",
    ),
    "family": Term(
        "Hazard family",
        "A group of similar kinds of hazard, such as things that suddenly come onto the road.",
    ),
    "required_clearance": Term(
        "Required clearance",
        "The distance from the hazard that a planner has to keep for full credit.",
    ),
    "flag": Term(
        "Flag",
        "A warning that the numbers of a row mean less than they seem to, for example because it always stands "
        "still. With most flags a row is never named as the best; with those that the protocol lists it takes "
        "no rank.",
    ),
    "reference": Term(
        "Reference rows",
        "Yardsticks scored by the same code, such as one that always stops. They take no rank.",
    ),
    "average": Term(
        "Two averages",
        "Mean of families: every hazard family counts the same. Mean of samples: every sample counts the "
        "same, so a family with many samples weighs more.",
    ),
    "split": Term(
        "Split",
        "A named set of samples. Of a withheld split, only the organizers know the hazard regions.",
    ),
    "protocol": Term(
        "Protocol",
        "The numbered set of rules and constants that turns files into scores. It never changes; "
        "a new one gets a new number, and old boards stay.",
    ),
    "paired": Term(
        "Compared sample by sample",
        "Both answered the same samples, so chance that affects both equally cancels out. That settles "
        "more than a look at two intervals.",
    ),
    "coverage": Term(
        "Answered samples",
        "The share of samples for which the file holds an answer. A missing path with the hazard counts as "
        "driving into it, a missing strategy as wrong and too careless.",
    ),
}  # fmt: skip

TERMS: Mapping[str, Term] = {**dict(_of_metrics()), **_WORDS}
"""Every word that a page explains, by its key."""
