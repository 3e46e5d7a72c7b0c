"""What a run did: answers, failures by reason, tokens, cost."""

from collections import Counter
from collections.abc import Sequence

from exceptiondrive_agent.journal import JournalLine
from exceptiondrive_endpoints.errors import Reason
from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.printable import one_line


class Prices(Document):
    """Price of a million tokens, in whatever currency the endpoint charges."""

    prompt: float
    completion: float


class RunReport(Document):
    """Totals of one run; `answered` counts earlier runs of the same journal too.

    `other_models` are the names under which answers came, other than the one that was asked for.
    `failure` is one of the failures in words, of an endpoint that did not answer if there is one.
    """

    samples: int
    answered: int
    asked: int
    done: int
    failed: dict[str, int]
    failure: str | None
    given_reminders: int
    requests: int
    prompt_tokens: int
    completion_tokens: int
    without_token_counts: int
    other_models: tuple[str, ...]
    unreachable: int
    cost: float | None
    out: str

    @property
    def text(self) -> str:
        """The report for a reader."""
        n_failed = sum(self.failed.values())
        uncounted = self.without_token_counts
        lines = [
            f"samples      {self.samples}, with an answer {self.answered}",
            f"this run     asked {self.asked}, done {self.done}, failed {n_failed}",
            *(f"  failed     {count} {reason}" for reason, count in self.failed.items()),
            f"requests     {self.requests}, samples asked with a reminder {self.given_reminders}",
            f"tokens       {self.prompt_tokens} in, {self.completion_tokens} out",
        ]
        if uncounted:
            lines.append(f"             the endpoint counted none for {uncounted} answers")
        if self.other_models:
            lines.append(f"answered by  {', '.join(map(one_line, self.other_models))}")
        if self.cost is not None:
            lines.append(f"cost         {self.cost:.4f}")
        return "\n".join((*lines, f"written to   {self.out}"))


def run_report(
    lines: Sequence[JournalLine],
    *,
    samples: int,
    answered: int,
    requests: int,
    model: str,
    prices: Prices | None,
    out: str,
) -> RunReport:
    """Sum up the journal lines of one run of `model`; `answered` are of earlier runs, too, `requests` with retries."""
    prompt = sum(line.prompt_tokens or 0 for line in lines)
    completion = sum(line.completion_tokens or 0 for line in lines)
    failed = Counter(line.reason.value for line in lines if line.reason is not None)
    return RunReport(
        samples=samples,
        answered=answered,
        asked=len(lines),
        done=sum(line.is_done for line in lines),
        failed=dict(failed.most_common()),
        failure=_most_telling_failure(lines),
        given_reminders=sum(line.given_reminder_digest is not None for line in lines),
        requests=requests,
        prompt_tokens=prompt,
        completion_tokens=completion,
        without_token_counts=sum(
            line.form is not None and line.prompt_tokens is None for line in lines
        ),
        other_models=tuple(sorted({line.model for line in lines if line.model} - {model})),
        unreachable=sum(line.reason is not None and line.reason.is_unreachable for line in lines),
        cost=cost(prices, prompt, completion),
        out=out,
    )


def _most_telling_failure(lines: Sequence[JournalLine]) -> str | None:
    """Return one failure in words: what keeps most from an answer, and says most, comes first."""
    failed = [(line.reason, line.detail) for line in lines if line.reason is not None]
    failed.sort(key=lambda each: (not each[0].is_unreachable, each[0] is Reason.NO_IMAGES))
    return next((detail or reason.value for reason, detail in failed), None)


def cost(prices: Prices | None, prompt_tokens: int, completion_tokens: int) -> float | None:
    """Cost of the counted tokens, or None without prices."""
    if prices is None:
        return None
    return (prices.prompt * prompt_tokens + prices.completion * completion_tokens) / 1e6
