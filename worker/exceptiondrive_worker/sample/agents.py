"""Synthetic driving agents that answer A to E, and the reminder that helps one of them.

They know the hazard of a sample and are wrong on purpose, about as often as the paper's agent.
"""

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.submission_files import ReminderRecord, RiskLevel, StrategyPrediction
from exceptiondrive_schemas.taxonomy import Strategy, Task
from exceptiondrive_worker.sample.scenes import SampleScene

LOOKS_RIGHT = 0.5
"""Probability that the agent is right without a reminder."""
REMINDED_RIGHT = 0.86
"""Probability that the reminder's recommendation is right."""
HEEDS = 0.73
"""Probability that the agent follows the recommendation."""
TOO_BOLD = 0.95
"""Share of the wrong answers that warn too little, if there is another way to be wrong."""
NAMED_TASK, NAMED_FAMILY, SEEN = 0.66, 0.82, 0.97
STOP_WITHIN_S, SLOW_WITHIN_S = 1.0, 1.6

Answer = Callable[[SampleScene, ProtocolDocument, str], StrategyPrediction]


@dataclass(frozen=True)
class Agent:
    """A synthetic agent: its name on the board, and how it answers.

    `without_reminder` is the method of the same agent without reminder, to which it is linked.
    """

    file_name: str
    method: str
    description: str
    answer: Answer
    without_reminder: str = ""


def looking(sample: SampleScene, protocol: ProtocolDocument, seed: str) -> StrategyPrediction:
    """Decide from what is visible: right slightly more often than not."""
    task = protocol.taxonomy.task(sample.task_id)
    strategy = _answer(task, LOOKS_RIGHT, Random(f"{seed}/look/{sample.sample_id}"))
    return StrategyPrediction(sample_id=sample.sample_id, strategy=strategy)


def reminded(sample: SampleScene, protocol: ProtocolDocument, seed: str) -> StrategyPrediction:
    """Decide like the same agent, but mostly follow a reminder that knows better."""
    reminder = _reminder(sample, protocol, Random(f"{seed}/remind/{sample.sample_id}"))
    own = looking(sample, protocol, seed)
    heeds = Random(f"{seed}/heed/{sample.sample_id}").random() < HEEDS
    strategy = reminder.recommended_strategy if heeds else own.strategy
    return StrategyPrediction(
        sample_id=sample.sample_id, strategy=strategy or own.strategy, reminder=reminder
    )


def time_gap_rule(sample: SampleScene, protocol: ProtocolDocument, seed: str) -> StrategyPrediction:
    """Stop, slow down or continue by the time to the hazard alone, whatever the hazard is."""
    time_s = sample.hazard.ahead_m / sample.speed_mps
    strategy = Strategy.A
    if time_s < SLOW_WITHIN_S:
        strategy = Strategy.C if time_s < STOP_WITHIN_S else Strategy.B
    return StrategyPrediction(sample_id=sample.sample_id, strategy=strategy)


AGENTS = (
    Agent(
        "time-gap-rule",
        "Time Gap Rule",
        "Stops, slows down or goes on by the seconds to the hazard, whatever the hazard is.",
        time_gap_rule,
    ),
    Agent(
        "looking-agent",
        "Looking Agent",
        "A synthetic agent that decides from what can be seen; right about half of the time.",
        looking,
    ),
    Agent(
        "looking-agent-with-reminder",
        "Looking Agent + Reminder",
        "The same synthetic agent with a risk reminder in each sample, which it mostly heeds.",
        reminded,
        without_reminder="Looking Agent",
    ),
)


def agent_predictions(
    agent: Agent, samples: tuple[SampleScene, ...], protocol: ProtocolDocument, seed: int
) -> tuple[StrategyPrediction, ...]:
    """Let one agent answer all samples; the same seed gives the same answers."""
    return tuple(agent.answer(sample, protocol, str(seed)) for sample in samples)


def _answer(task: Task, right: float, rng: Random) -> Strategy:
    """Return an acceptable answer, or a wrong one that mostly warns too little."""
    over = set(Strategy) - set(task.acceptable) - set(task.under_warning)
    if rng.random() < right:
        return rng.choice(task.acceptable)
    if over and rng.random() >= TOO_BOLD:
        return rng.choice(sorted(over))
    return rng.choice(task.under_warning)


def _reminder(sample: SampleScene, protocol: ProtocolDocument, rng: Random) -> ReminderRecord:
    task = protocol.taxonomy.task(sample.task_id)
    if rng.random() >= SEEN:
        return ReminderRecord(hazard_present=False, risk_level="none")
    named = _named_task(task, protocol, rng.random(), rng)
    strategy = _answer(task, REMINDED_RIGHT, rng)
    side = "left" if sample.hazard.right_m > 0 else "right" if sample.hazard.left_m < 0 else "path"
    where = "in the path" if side == "path" else f"to the {side} of the path"
    risk: RiskLevel = "high" if sample.hazard.ahead_m < sample.speed_mps else "medium"
    return ReminderRecord(
        hazard_present=True,
        hazard_type=named.id,
        relative_location=f"{sample.hazard.ahead_m:.0f} m ahead, {where}",
        risk_level=risk,
        evidence=named.hazard,
        safety_constraint=f"keep {named.d_safe_m:g} m clear of it",
        recommended_strategy=strategy,
    )


def _named_task(task: Task, protocol: ProtocolDocument, draw: float, rng: Random) -> Task:
    """Return the task itself, another one of its family, or any."""
    if draw < NAMED_TASK:
        return task
    if draw < NAMED_FAMILY:
        return rng.choice(protocol.taxonomy.tasks_of(task.family))
    return rng.choice(protocol.tasks)
