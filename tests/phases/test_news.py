"""What organizers announce and what teams ask: page, feed, inbox, and who may do what."""

from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import send, visitor

from exceptiondrive_records.news.news import list_news
from exceptiondrive_records.news.questions import list_questions

if TYPE_CHECKING:
    from tests.phases.life import Life

NEWS = {"title": "The workshop moves", "text": "It is on **Friday** now."}
QUESTION = "May a planner use <b>maps</b>?"
ANSWER = "Yes, *offline* ones."


def inbox(life: "Life", team: str) -> list[str]:
    return [notice["title"] for notice in life.json("/api/v1/notifications", team)]


def told(life: "Life", team: str) -> list[str]:
    """Return the sentences of the newest notice of a team."""
    sentences: list[str] = life.json("/api/v1/notifications", team)[0]["what_changed"]
    return sentences


def last_line(life: "Life") -> tuple[str, str]:
    line = life.json("/api/v1/organizer/audit?limit=1", "organizer")[0]
    return line["action"], line["subject"]


@pytest.fixture
def open_phase(life: "Life") -> "Life":
    life.make_phase(split="plain")
    return life


@pytest.mark.parametrize("by", ["page", "api"])
def test_news_stand_on_the_page_in_the_feed_and_in_every_inbox_until_withdrawn(
    open_phase: "Life", by: str
) -> None:
    life, organizer = open_phase, visitor(open_phase, "organizer")
    assert "The workshop" not in life.get("/phases/test").text
    if by == "page":
        page = "/organize/phases/test/news"
        assert f'href="{page}"' in organizer.get("/organize/news").text
        assert send(organizer, page, NEWS, page=page).status_code == 303
    else:
        life.done("/phases/test/news", NEWS)
    (published,) = life.json("/api/v1/phases/test/news")
    assert last_line(life) == ("news published", published["id"])
    assert "It is on <strong>Friday</strong> now." in life.get("/phases/test").text
    feed = life.get("/feed.atom?phase=test").text
    assert "The workshop moves" in feed
    assert "<summary>It is on Friday now.</summary>" in feed, "without the marks of Markdown"
    anchor = f"news-{published['id']}"
    assert feed.count(f"/phases/test#{anchor}") == 2, "name and link"
    assert f'id="{anchor}"' in life.get("/phases/test").text
    for team in ("alpha", "beta"):
        assert "The workshop moves" in inbox(life, team)[0]
        assert told(life, team) == ["It is on Friday now."]
        page, _, place = life.json("/api/v1/notifications", team)[0]["comparison"].partition("#")
        assert f'id="{place}"' in life.get(page).text, "the notice leads to the news themselves"
    assert "very message" in life.refused("/phases/test/news", NEWS, 409)
    assert len(life.json("/api/v1/phases/test/news")) == 1
    if by == "page":
        page = f"/organize/news/{published['id']}/withdraw"
        assert page in organizer.get("/organize/news").text
        assert send(organizer, page, {"reason": "wrong"}, page=page).status_code == 303
    else:
        life.done(f"/news/{published['id']}/withdraw", {"reason": "wrong"})
    assert last_line(life) == ("news withdrawn", published["id"])
    assert life.json("/api/v1/phases/test/news") == []
    assert "The workshop" not in life.get("/phases/test").text
    assert "The workshop" not in life.get("/feed.atom?phase=test").text
    again = life.refused(f"/news/{published['id']}/withdraw", {"reason": "again"}, 409)
    assert "This news is withdrawn already." in again


def asked(life: "Life", by: str) -> Any:
    if by == "page":
        page = "/my/questions/test"
        done = send(visitor(life, "alpha"), page, {"text": QUESTION}, page=page)
        assert done.status_code == 303
    else:
        body = {"text": QUESTION}
        answer = life.request("POST", "/api/v1/phases/test/questions", "alpha", json=body)
        assert answer.status_code == 201, answer.text
    (question,) = life.json("/api/v1/phases/test/questions", "alpha")
    return question


def test_one_question_in_two_phases_gets_the_same_answer_in_both(open_phase: "Life") -> None:
    life = open_phase
    life.make_phase("two", split="plain", title="Two")
    for phase in ("test", "two"):
        address = f"/api/v1/phases/{phase}/questions"
        question = life.request("POST", address, "alpha", json={"text": QUESTION}).json()
        life.done(f"/questions/{question['id']}/answer", {"text": ANSWER})
    assert inbox(life, "alpha") == ["Two: A question, answered", "Test: A question, answered"]


@pytest.mark.parametrize("by", ["page", "api"])
def test_a_question_is_answered_to_the_team_alone(open_phase: "Life", by: str) -> None:
    life, organizer = open_phase, visitor(open_phase, "organizer")
    question = asked(life, by)
    assert last_line(life) == ("question asked", question["id"])
    assert "1 question from teams waits for an answer" in organizer.get("/organize").text
    page = f"/organize/news/questions/{question['id']}"
    assert page in organizer.get("/organize/news").text
    assert '<td data-k="phase">Test</td>' in organizer.get("/organize/news").text
    if by == "page":
        assert send(organizer, page, {"text": ANSWER}, page=page).status_code == 303
    else:
        life.done(f"/questions/{question['id']}/answer", {"text": ANSWER})
    assert last_line(life) == ("question answered", question["id"])
    (seen,) = life.json("/api/v1/phases/test/questions", "alpha")
    assert (seen["answer"], seen["is_public"]) == (ANSWER, False)
    assert "Yes, <em>offline</em> ones." in visitor(life, "alpha").get("/my/questions/test").text
    assert told(life, "alpha")[-1] == "Yes, offline ones."
    assert life.json("/api/v1/notifications", "alpha")[0]["comparison"] == "/my/questions/test"
    assert inbox(life, "alpha") == ["Test: A question, answered"]
    assert inbox(life, "beta") == []
    assert life.json("/api/v1/phases/test/questions", "beta") == []
    assert life.json("/api/v1/phases/test/news") == []
    again = {"text": "No.", "to_all": True}
    assert "already" in life.refused(f"/questions/{question['id']}/answer", again, 409)


def test_the_newest_stands_first_and_a_question_that_waits_longest_before_all(
    open_phase: "Life",
) -> None:
    life = open_phase
    life.make_phase("two", split="plain", title="Two")
    asked = []
    for words in ("One?", "Two?", "Three?"):
        body, path = {"text": words}, "/api/v1/phases/test/questions"
        asked.append(life.request("POST", path, "alpha", json=body).json()["id"])
        life.done("/phases/test/news", {"title": words, "text": words})
    life.done(f"/questions/{asked[1]}/answer", {"text": ANSWER})
    with life.database.read() as session:
        announced = [one.title for one in list_news(session)]
        listed = [question.id for question, _ in list_questions(session, "test")]
        elsewhere = list_questions(session, "two")
    assert announced == ["Three?", "Two?", "One?"]
    assert (listed, elsewhere) == ([asked[0], asked[2], asked[1]], [])
    mine = life.json("/api/v1/phases/test/questions", "alpha")
    assert [one["id"] for one in mine] == asked[::-1]


def test_an_answer_to_all_does_not_say_who_asked(open_phase: "Life") -> None:
    life = open_phase
    question = asked(life, "api")
    life.done(f"/questions/{question['id']}/answer", {"text": ANSWER, "to_all": True})
    text = life.get("/phases/test").text
    assert "&lt;b&gt;maps" in text
    assert "<b>maps" not in text
    assert "<em>offline</em>" in text
    assert "alpha" not in life.get("/api/v1/phases/test/news").text.lower()
    for team in ("alpha", "beta"):
        assert "A question, answered" in inbox(life, team)[0]
        assert told(life, team)[-1] == "Yes, offline ones."


def test_a_question_changes_no_link_of_its_answer(open_phase: "Life") -> None:
    life = open_phase
    words = "[protocol]: https://evil.test\n# Big\n1. one\n[a](https://evil.test)\n---"
    body = {"text": words}
    asked = life.request("POST", "/api/v1/phases/test/questions", "alpha", json=body)
    assert asked.status_code == 201
    path = f"/questions/{asked.json()['id']}/answer"
    life.done(path, {"text": "See the [protocol].", "to_all": True})
    text = life.get("/phases/test").text
    told = text[text.index('id="news-') :]
    told = told[: told.index("</article>")]
    assert "See the [protocol]." in told
    assert "[protocol]: https://evil.test" in told
    assert "# Big" in told
    for tag in ("<a ", "<h5", "<ol", "<hr"):
        assert tag not in told
    notice = life.json("/api/v1/notifications", "beta")[0]
    said = "\n".join(notice["what_changed"])
    assert ("1. one" in said, "\\" in said) == (True, False), "an inbox knows no Markdown"


def test_no_question_is_too_long_to_be_answered(open_phase: "Life") -> None:
    life = open_phase
    for words in ("\n".join("*" * 500), "#" * 1000):
        body = {"text": words}
        asked = life.request("POST", "/api/v1/phases/test/questions", "alpha", json=body).json()
        life.done(f"/questions/{asked['id']}/answer", {"text": "No.", "to_all": True})


@pytest.mark.parametrize("to_all", [True, False])
def test_a_question_speaks_to_no_inbox_in_the_organizers_name(
    open_phase: "Life", *, to_all: bool
) -> None:
    life = open_phase
    words = "May we use maps?\n\nAnswer of the organizers: yes.\n> \n\nYour organizers"
    body = {"text": words}
    asked = life.request("POST", "/api/v1/phases/test/questions", "alpha", json=body).json()
    life.done(f"/questions/{asked['id']}/answer", {"text": "No.\n\nNever.", "to_all": to_all})
    said = life.json("/api/v1/notifications", "beta" if to_all else "alpha")[0]["what_changed"]
    answer = said.index("The organizers answer:")
    assert all(line.startswith("> ") for line in said[:answer])
    assert said[answer + 1 :] == ["No.", "Never."]


def test_who_may_not_is_refused(open_phase: "Life") -> None:
    life = open_phase
    question = asked(life, "api")
    for path, body in (
        ("/phases/test/news", NEWS),
        (f"/questions/{question['id']}/answer", {"text": ANSWER}),
        ("/news/x/withdraw", {"reason": "x"}),
    ):
        sent = life.request("POST", f"/api/v1/organizer{path}", "alpha", json=body)
        assert sent.status_code == 403, path
    assert life.get("/api/v1/organizer/questions", "alpha").status_code == 403
    assert life.get("/api/v1/phases/test/questions").status_code == 401
    life.change({"visibility": "hidden"})
    assert "hidden" in life.refused("/phases/test/news", NEWS, 409)
    assert life.get("/api/v1/phases/test/news").status_code == 404


def test_a_team_asks_a_thing_once_and_only_so_many(open_phase: "Life") -> None:
    life = open_phase
    asked(life, "api")
    for n, status in enumerate((409, 201, 201, 201, 201, 409)):
        body = {"text": QUESTION if n == 0 else f"And {n}?"}
        sent = life.request("POST", "/api/v1/phases/test/questions", "alpha", json=body)
        assert sent.status_code == status, sent.text
