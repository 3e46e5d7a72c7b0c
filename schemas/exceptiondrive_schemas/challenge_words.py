"""What pages and reasons say of a challenge. A page branches on none: it sets these words."""

from typing import Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document

Outcome = Literal["kept", "lost", "hit"]


class HeadlineWords(Document):
    """The page's headline, chosen by the share of the best entry in the second primary metric.

    `{often}` is set as "once in 3", `{cases}` as "one hazard in 3", `{rest}` as `{often}` of the
    other samples.
    """

    question: str
    """Where nothing is scored yet."""
    by_share: tuple[tuple[float, str], ...] = Field(min_length=1)
    """From this share on, these words; highest first, the last one from 0 on."""


class CodeWords(Document):
    """What the quick start shows: file and method names, and a loop that writes the file."""

    file: str
    method: str
    loop: str
    """Python; `{file}` and `{split}` are filled in."""


class ChallengeWords(Document):
    """Words of one challenge. Between double stars stands what is set bold."""

    subject: str
    """What is submitted: "planner", "agent"."""
    subjects: str
    answers: str
    """What the file holds: "trajectories", "answers"."""
    task: str
    """Goes on after "ExceptionDrive puts a hazard into a real driving scene and"."""
    scene_caption: str
    """Under the drawing; `{clearance_m}`, `{d_safe_m}` and `{hcc}` are filled in."""
    sample_note: str
    """What a sample is, under the number of samples."""
    headline: HeadlineWords
    ceiling_title: str
    ceiling_note: str
    outcome: dict[Outcome, str]
    """The three parts of all samples, in the legend of the outcome bar."""
    covered: dict[str, str]
    """What the shares of a coverage count: "edited" and, where there is one, "source"."""
    file_note: str
    """What a file is made of, in a sentence."""
    code: CodeWords


PLANNING_WORDS = ChallengeWords(
    subject="planner",
    subjects="planners",
    answers="trajectories",
    task="asks the planner to drive it again. Trajectories are scored here, against hazard regions "
    "that nobody outside can see.",
    scene_caption="One edited scene from above, to scale. **UR** counts tubes that touch the red "
    "core. **HCC** pays for clearance up to the amber line: here d = {clearance_m:.2f} of "
    "{d_safe_m:.2f} m, so {hcc:.2f}. **CTS** is the mean gap between the dotted and the solid "
    "trajectory.",
    sample_note="source\u2013edited pairs",
    headline=HeadlineWords(
        question="Which planner keeps clear of the hazard?",
        by_share=(
            (0.995, "No planner keeps clear of the hazard yet."),
            (0.501, "Even the safest planner meets the hazard {often}."),
            (0.1, "The safest planner still meets {cases}."),
            (0.0, "The safest planner keeps clear {rest}."),
        ),
    ),
    ceiling_title="Compliance has a ceiling",
    ceiling_note="A planner earns clearance only where it stays out of the hazard, so HCC can "
    "never pass 100 minus UR. The dotted drop is clearance lost by passing too close.",
    outcome={
        "kept": "clearance kept (HCC)",
        "lost": "clear but too close",
        "hit": "in the hazard (UR)",
    },
    covered={"edited": "edited trajectories", "source": "source trajectories"},
    file_note="One JSON file with {waypoints} waypoints per trajectory, two trajectories per "
    "sample.",
    code=CodeWords(
        file="planner.json.gz",
        method="My planner",
        loop="""\
from recorder import Recorder  # one file, standard library only

with Recorder("{file}", split="{split}") as recorder:
    for sample_id, source, edited in samples:
        recorder.add(sample_id, source=plan(source), edited=plan(edited))
""",
    ),
)

STRATEGY_WORDS = ChallengeWords(
    subject="agent",
    subjects="agents",
    answers="answers",
    task="asks an agent what to do about it. Answers are scored here, against what is acceptable "
    "for each task; which sample is which task, nobody outside can see.",
    scene_caption="One edited scene from above, to scale. The agent answers with a strategy: "
    "**A** maintain path, **B** slow down, **C** stop, **D** yield, **E** prepare to bypass. "
    "**Under-warning** counts answers that are wrong and too careless.",
    sample_note="edited scenes",
    headline=HeadlineWords(
        question="Which agent is careful enough?",
        by_share=(
            (0.995, "No agent is careful enough yet."),
            (0.1, "Even the most careful agent warns too little {often}."),
            (0.0, "The most careful agent is careful enough {rest}."),
        ),
    ),
    ceiling_title="Accuracy has a ceiling",
    ceiling_note="A wrong answer that is too careless cannot be right, so accuracy can never pass "
    "100 minus under-warning. The dotted drop is what was lost by other wrong answers.",
    outcome={
        "kept": "acceptable strategy",
        "lost": "too cautious or sideways",
        "hit": "under-warning",
    },
    covered={"edited": "answers"},
    file_note="One JSON file with one letter per sample: what the agent would do in the edited "
    "scene.",
    code=CodeWords(
        file="agent.json.gz",
        method="My agent",
        loop="""\
from recorder import StrategyRecorder  # one file, standard library only

with StrategyRecorder("{file}", split="{split}") as recorder:
    for sample_id, images in samples:
        recorder.add(sample_id, strategy=decide(images))  # "A" to "E", or None
""",
    ),
)
