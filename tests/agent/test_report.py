from exceptiondrive_agent.journal import JournalLine
from exceptiondrive_agent.report import Prices, cost, run_report
from exceptiondrive_endpoints.errors import Reason

LINES = (
    JournalLine(
        sample_id="a", form="json_schema", prompt_tokens=1_500_000, completion_tokens=100, model="m"
    ),
    JournalLine(sample_id="b", form="words", model="other\x1b[2J"),
    JournalLine(sample_id="c", reason=Reason.TIMEOUT),
    JournalLine(sample_id="d", reason=Reason.NOT_JSON, form="words", prompt_tokens=500_000),
    JournalLine(sample_id="e", reason=Reason.NOT_JSON, form="words", prompt_tokens=0),
)


def test_a_report_counts_answers_failures_tokens_and_cost() -> None:
    prices = Prices(prompt=2.0, completion=10.0)
    report = run_report(
        LINES, samples=9, answered=4, requests=12, model="m", prices=prices, out="f.jsonl"
    )
    assert (report.asked, report.done, report.unreachable) == (5, 2, 1)
    assert report.failed == {"not_json": 2, "timeout": 1}
    assert (report.prompt_tokens, report.completion_tokens) == (2_000_000, 100)
    assert report.without_token_counts == 1
    assert report.cost == 4.001
    assert "failed     2 not_json" in report.text
    assert "answered by  other\ufffd[2J\n" in report.text
    assert "cost         4.0010" in report.text
    assert "counted none for 1 answers" in report.text


def test_without_prices_no_cost_is_claimed() -> None:
    assert cost(None, 10, 10) is None
    report = run_report((), samples=1, answered=1, requests=0, model="m", prices=None, out="f")
    assert "cost" not in report.text
    assert "answered by" not in report.text
